use super::*;
use std::sync::atomic::{AtomicUsize, Ordering};

const NUMBERS: CacheKind = CacheKind { name: "numbers", version: 1 };

/// Returns a cache, and a counter of the cache's notes.
fn cache(folder: &Path) -> (DiskCache, Arc<AtomicUsize>) {
    let notes = Arc::new(AtomicUsize::new(0));
    let count = notes.clone();
    let note = move |sentence: &str| {
        assert!(sentence.contains("is damaged or of another version"), "{sentence}");
        count.fetch_add(1, Ordering::Relaxed);
    };
    (DiskCache::new(folder, note), notes)
}

#[test]
fn entries_are_read_for_their_own_inputs_kind_and_content() {
    let folder = tempfile::tempdir().unwrap();
    let (cache, notes) = cache(folder.path());
    assert_eq!(cache.load(NUMBERS, &(1, 0.5)), None);
    assert_eq!(cache.save(NUMBERS, &(1, 0.5), b"one").unwrap(), 35);
    assert_eq!(cache.load(NUMBERS, &(1, 0.5)).as_deref(), Some(b"one".as_slice()));
    assert_eq!(cache.load(NUMBERS, &(2, 0.5)), None);
    assert_eq!(cache.load(CacheKind { version: 2, ..NUMBERS }, &(1, 0.5)), None);
    assert_eq!(cache.load(CacheKind { name: "others", ..NUMBERS }, &(1, 0.5)), None);
    assert_eq!(cache.for_content("other").load(NUMBERS, &(1, 0.5)), None);
    let value = BTreeMap::from([("x".to_owned(), 1e-300)]);
    cache.save_json(NUMBERS, &"json", &value).unwrap();
    assert_eq!(cache.load_json(NUMBERS, &"json"), Some(value));
    assert_eq!(notes.load(Ordering::Relaxed), 0);
    assert_eq!(cache.load_json::<u8>(NUMBERS, &"json"), None);
    assert_eq!(notes.load(Ordering::Relaxed), 1, "of another type");
}

#[test]
fn every_changed_bit_and_every_length_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("entry");
    let key = blake3::hash(b"key");
    let bytes = [checksum(&key, b"content").as_bytes(), b"content".as_slice()].concat();
    let holds = |bytes: &[u8], key: &blake3::Hash| {
        std::fs::write(&path, bytes).unwrap();
        unsealed(&path, key).is_some()
    };
    for at in 0..bytes.len() {
        for bit in 0..8 {
            let mut flipped = bytes.clone();
            flipped[at] ^= 1 << bit;
            assert!(!holds(&flipped, &key), "byte {at}, bit {bit}");
        }
        assert!(!holds(&bytes[..at], &key), "{at} bytes");
    }
    assert!(holds(&bytes, &key) && !holds(&bytes, &blake3::hash(b"other")));
}

#[test]
fn damaged_entries_are_noted_once_and_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let (cache, notes) = cache(folder.path());
    let _ = [1, 2].map(|n| cache.save(NUMBERS, &n, b"content").unwrap());
    let [one, two] = [1, 2].map(|n| cache.path(NUMBERS, &n).unwrap());
    std::fs::copy(&two, &one).unwrap();
    assert!(cache.load(NUMBERS, &1).is_none() && cache.load(NUMBERS, &1).is_none());
    assert_eq!(notes.load(Ordering::Relaxed), 1, "of another entry");
    std::fs::remove_file(&two).unwrap();
    std::os::unix::fs::symlink("/dev/zero", &two).unwrap();
    assert!(cache.load(NUMBERS, &2).is_none());
    assert_eq!(notes.load(Ordering::Relaxed), 2, "a link to a device");
    cache.save(NUMBERS, &2, b"content").unwrap();
    assert!(cache.load(NUMBERS, &2).is_some());
}

#[test]
fn entries_unused_for_longest_are_removed_first() {
    let folder = tempfile::tempdir().unwrap();
    let content = [0; 100 - blake3::OUT_LEN];
    let age = |cache: &DiskCache, n: u8, hours: u64| {
        let used = SystemTime::now() - Duration::from_secs(3600 * hours);
        let file = File::open(cache.path(NUMBERS, &n).unwrap()).unwrap();
        file.set_modified(used).unwrap();
    };
    let cache = DiskCache::bounded(folder.path(), 350, |_| ());
    for n in 0..3 {
        cache.save(NUMBERS, &n, &content).unwrap();
        age(&cache, n, 10 - u64::from(n));
    }
    cache.load(NUMBERS, &0).unwrap();
    // The size of an entry includes its additional files. They are removed together with the entry.
    let files = cache.files(NUMBERS, &1).unwrap();
    std::fs::create_dir(&files).unwrap();
    std::fs::write(files.join("0.png"), [0; 20]).unwrap();
    assert_eq!(cache.listing()[0], CacheUse { kind: "numbers".into(), entries: 3, bytes: 320 });
    let used = SystemTime::now() - Duration::from_secs(3600 * 9);
    File::open(&files).unwrap().set_modified(used).unwrap();
    cache.save(NUMBERS, &3, &content).unwrap();
    let there: Vec<bool> = (0..4).map(|n| cache.load(NUMBERS, &n).is_some()).collect();
    assert_eq!(there, [true, false, true, true]);
    assert!(!files.exists());

    // Recently used entries and pinned entries are not removed.
    age(&cache, 2, 5);
    cache.pin(&cache.path(NUMBERS, &2).unwrap());
    for n in 4..8 {
        cache.save(NUMBERS, &n, &content).unwrap();
    }
    assert_eq!(cache.listing()[0].entries, 7);
}

#[test]
fn kinds_are_listed_and_deleted() {
    let folder = tempfile::tempdir().unwrap();
    let (cache, _) = cache(folder.path());
    assert!(cache.listing().is_empty());
    assert_eq!(cache.delete(None).unwrap().entries, 0);
    for wrong in ["", ".", "..", "../cache", "/", "numbers/.."] {
        assert!(cache.delete(Some(wrong)).is_err(), "{wrong}");
    }
    let others = CacheKind { name: "others", version: 1 };
    assert!(!cache.has(others));
    cache.save(NUMBERS, &1, b"12").unwrap();
    cache.save(NUMBERS, &2, b"12").unwrap();
    cache.save(others, &1, b"12").unwrap();
    assert!(cache.has(others));
    std::fs::write(folder.path().join(FOLDER).join("others/lock"), "").unwrap();
    let listing = cache.listing().into_iter().map(|of| (of.kind, of.entries, of.bytes));
    let expected = [("numbers".to_owned(), 2, 68), ("others".to_owned(), 1, 34)];
    assert!(listing.eq(expected));
    assert_eq!(cache.delete(Some("numbers")).unwrap().bytes, 68);
    assert_eq!((cache.listing().len(), cache.load(NUMBERS, &1)), (1, None));
    assert_eq!(cache.delete(None).unwrap().entries, 1);
    assert!(!folder.path().join(FOLDER).exists());
}

#[test]
fn links_lead_nowhere() {
    for link in [".stlfr", FOLDER, ".stlfr/cache/numbers"] {
        let [folder, elsewhere] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let (cache, _) = cache(folder.path());
        let link = folder.path().join(link);
        std::fs::create_dir_all(link.parent().unwrap()).unwrap();
        std::os::unix::fs::symlink(elsewhere.path(), &link).unwrap();
        assert_eq!(cache.link(NUMBERS), Some(link.clone()));
        let error = cache.save(NUMBERS, &1, b"1").unwrap_err().to_string();
        assert!(error.contains("is a link"), "{error}");
        assert!(cache.load(NUMBERS, &1).is_none() && cache.listing().is_empty());
        assert!(cache.delete(Some("numbers")).is_err());
        assert_eq!(elsewhere.path().read_dir().unwrap().count(), 0);
    }
}

#[test]
fn a_read_only_capture_is_read_all_the_same() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let (cache, _) = cache(folder.path());
    cache.save(NUMBERS, &1, b"1").unwrap();
    let numbers = folder.path().join(FOLDER).join("numbers");
    let allow = |mode| {
        std::fs::set_permissions(&numbers, std::fs::Permissions::from_mode(mode)).unwrap();
    };
    allow(0o555);
    assert!(cache.load(NUMBERS, &1).is_some());
    // The superuser can write in spite of the permissions.
    let _ = cache.save(NUMBERS, &2, b"2");
    allow(0o755);
}
