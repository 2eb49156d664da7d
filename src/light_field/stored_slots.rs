//! Stores the depth and motion of slots' frames on disk, several slots at a time.

use super::scene_flow::slot_maps;
use super::slots::{FrameId, Slot, Slots};
use super::stages::{FlowOptions, FrameFlow};
use super::still_depth::{StillCameras, still_cameras, store_still_cameras};
use super::{Context, RenderError};
use crate::capture::Stored;
use crate::host::{lock, memory_bytes};
use crate::scene_flow::FlowMap;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

/// Memory that the estimation of a slot takes for each pixel of its frames, bytes, as measured: 190 for eight cameras, 300 for
/// three.
const BYTES_PER_PIXEL: usize = 300;
/// Part of the machine's memory that slots which are estimated at a time may take: one in this many. A single slot is
/// estimated whatever it takes.
const MEMORY_PARTS: usize = 4;

/// Stores the maps of depth and motion of the frames of slots on disk, unless they are there already. For each slot, `each`
/// is called with what is stored of its frames, in ascending order of camera and frame index. The list is empty if the range
/// of the scene's depths is unknown: then there are no maps, and views are rendered by other methods. The slots may finish
/// in any order.
///
/// # Errors
/// The first error of a slot, and that of `each`. No further slot is begun then.
pub(super) fn store_slots(
    slots: &Slots,
    list: &[Slot],
    options: FlowOptions,
    each: impl FnMut(&[Stored]) -> Result<(), RenderError> + Send,
) -> Result<(), RenderError> {
    let each = Mutex::new(each);
    let at_a_time = slots_at_a_time(slots, list, rayon::current_num_threads());
    let groups: BTreeSet<usize> = list.iter().map(|slot| slot.group).collect();
    // One group after the other, so that the background of only one group is in memory.
    groups.into_iter().try_for_each(|group| {
        let list: Vec<Slot> = list.iter().copied().filter(|slot| slot.group == group).collect();
        let missing = list.iter().find(|slot| !is_stored(slots, **slot, options));
        let stills = missing.map(|&slot| stored_still_cameras(slots, slot, options)).transpose()?;
        for_each_in_order(&list, at_a_time, |&slot| {
            let stored = store_slot(slots, slot, stills.as_ref(), options)?;
            lock(&each)(&stored)
        })
    })
}

/// Returns the static background of the cameras that filmed a slot, and stores its depth on disk. It and the cameras' gains are
/// computed once here, before threads request them in parallel.
fn stored_still_cameras(
    slots: &Slots,
    slot: Slot,
    options: FlowOptions,
) -> Result<StillCameras, RenderError> {
    slots.field.gains(options.registration);
    let stills = still_cameras(slots, slot, options, &Context::unattended())?;
    store_still_cameras(slots.field, &stills, options)?;
    Ok(stills)
}

/// Calls `f` for all items, for up to `at_a_time` of them at a time. An item is begun when those before it are begun. After
/// an error no further item is begun, and the error is returned.
fn for_each_in_order<T: Sync, E: Send>(
    items: &[T],
    at_a_time: usize,
    f: impl Fn(&T) -> Result<(), E> + Sync,
) -> Result<(), E> {
    let next = AtomicUsize::new(0);
    let process = || {
        while let Some(item) = items.get(next.fetch_add(1, Ordering::Relaxed)) {
            f(item).inspect_err(|_| next.store(items.len(), Ordering::Relaxed))?;
        }
        Ok(())
    };
    (0..at_a_time).into_par_iter().with_max_len(1).try_for_each(|_| process())
}

/// Returns how many of the slots are estimated at a time.
fn slots_at_a_time(slots: &Slots, list: &[Slot], threads: usize) -> usize {
    let cameras = &slots.field.capture().cameras;
    let maps = list.iter().map(|&slot| slots.cameras(slot).len()).max().unwrap_or(0);
    let pixels = cameras.iter().map(|c| c.camera.width * c.camera.height).max().unwrap_or(0);
    at_a_time(maps, pixels, threads, memory_bytes().unwrap_or(0)).min(list.len())
}

/// Returns how many slots of `maps` maps of `pixels` pixels are estimated at a time, at least 1. The maps of a slot wait for
/// each other after every pass, so that threads are idle with a single slot, even if it has more maps than there are
/// threads. So there is one slot more than have a map for each thread, if the memory suffices.
fn at_a_time(maps: usize, pixels: usize, threads: usize, memory_bytes: usize) -> usize {
    let slot_bytes = (maps * pixels * BYTES_PER_PIXEL).max(1);
    let by_memory = memory_bytes / MEMORY_PARTS / slot_bytes;
    let by_threads = if threads > 1 { 1 + threads.div_ceil(maps.max(1)) } else { 1 };
    by_threads.min(by_memory).max(1)
}

fn is_stored(slots: &Slots, slot: Slot, options: FlowOptions) -> bool {
    let stored = |frame: FrameId| slots.field.stored(&FrameFlow { frame, options }).is_some();
    slots.frames(slot).into_iter().all(stored)
}

/// Stores the maps of a slot's frames on disk, unless they are there already. `stills` is the static background of its
/// cameras; `None` if the maps are there.
fn store_slot(
    slots: &Slots,
    slot: Slot,
    stills: Option<&StillCameras>,
    options: FlowOptions,
) -> Result<Vec<Stored>, RenderError> {
    let field = slots.field;
    let flow = |frame: FrameId| FrameFlow { frame, options };
    let there: Vec<(FrameId, Option<Stored>)> =
        slots.frames(slot).into_iter().map(|frame| (frame, field.stored(&flow(frame)))).collect();
    let Some(stills) = stills.filter(|_| there.iter().any(|(_, stored)| stored.is_none())) else {
        return Ok(there.into_iter().filter_map(|(_, stored)| stored).collect());
    };
    let maps = slot_maps(slots, slot, stills, options, &Context::unattended())?;
    let Some(maps) = maps else { return Ok(Vec::new()) };
    let store = |((frame, map), (_, stored)): (&(FrameId, Arc<FlowMap>), _)| match stored {
        Some(stored) => Ok(stored),
        None => field.store(&flow(*frame), map),
    };
    maps.par_iter().zip(there).map(store).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    /// Runs with eight threads. Returns how often each of 200 items was begun, the most that ran at a time, and the result.
    /// The item `failing` fails.
    fn run(at_a_time: usize, failing: Option<usize>) -> (Vec<usize>, usize, Result<(), usize>) {
        let items: Vec<usize> = (0..200).collect();
        let begun: Vec<AtomicUsize> = items.iter().map(|_| AtomicUsize::new(0)).collect();
        let (running, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(8).build().expect("a pool");
        let process = |&item: &usize| {
            begun[item].fetch_add(1, Ordering::Relaxed);
            most.fetch_max(running.fetch_add(1, Ordering::Relaxed) + 1, Ordering::Relaxed);
            // What an item does in parallel is shared among all threads.
            (0..4).into_par_iter().for_each(|_| std::thread::sleep(Duration::from_millis(1)));
            running.fetch_sub(1, Ordering::Relaxed);
            if Some(item) == failing { Err(item) } else { Ok(()) }
        };
        let result = pool.install(|| for_each_in_order(&items, at_a_time, process));
        (begun.into_iter().map(AtomicUsize::into_inner).collect(), most.into_inner(), result)
    }

    #[test]
    fn all_items_are_processed_once_and_only_a_few_at_a_time() {
        for at_a_time in [1, 3] {
            let (begun, most, result) = run(at_a_time, None);
            assert!(result.is_ok() && most <= at_a_time, "{most}");
            assert_eq!(begun, [1; 200]);
        }
    }

    #[test]
    fn after_an_error_no_further_item_is_begun() {
        for at_a_time in [1, 3] {
            let (begun, _, result) = run(at_a_time, Some(10));
            assert_eq!(result, Err(10));
            // The others that ran at this time ended, and some may have begun further items meanwhile.
            let begun = begun.iter().sum::<usize>();
            assert!((11..200).contains(&begun), "{begun} items by {at_a_time}");
        }
    }

    #[test]
    fn slots_at_a_time_keep_all_threads_busy_within_a_quarter_of_the_memory() {
        let (vga, memory) = (640 * 480, 24 << 30);
        for ((maps, pixels, threads, memory), expected) in [
            ((8, vga, 1, memory), 1),
            ((8, vga, 2, memory), 2),
            ((8, vga, 16, memory), 3),
            ((3, vga, 2, memory), 2),
            ((3, vga, 16, memory), 7),
            ((12, 1920 * 1080, 16, memory), 1),
            ((8, vga, 16, 6 << 30), 2),
            ((8, vga, 16, 0), 1),
            ((0, 0, 2, memory), 3),
        ] {
            assert_eq!(at_a_time(maps, pixels, threads, memory), expected);
        }
    }
}
