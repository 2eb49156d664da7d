//! Arrays in numpy's file format, version 1: C order, little-endian.

use crate::host::open_bounded;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// An error of an array's file. Every message is one sentence with the file.
#[derive(Debug, thiserror::Error)]
pub enum NpyError {
    /// The file can't be read.
    #[error("{path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    /// The file is no array of the wanted type and number of axes.
    #[error("{path}: {reason}")]
    Content { path: PathBuf, reason: String },
}

/// A type of number that an array may hold.
pub trait Element: Sized {
    /// Numpy's code of the type, such as `<f4`.
    const DESCR: &'static str;
    /// The type in words, for messages.
    const NAME: &'static str;
    /// Size of one element.
    const BYTES: usize;
    /// An element from exactly [`Self::BYTES`] bytes.
    fn from_le(bytes: &[u8]) -> Self;
}

macro_rules! element {
    ($type:ty, $descr:literal, $name:literal) => {
        impl Element for $type {
            const DESCR: &'static str = $descr;
            const NAME: &'static str = $name;
            const BYTES: usize = size_of::<$type>();
            fn from_le(bytes: &[u8]) -> Self {
                let mut exact = [0; size_of::<$type>()];
                exact.copy_from_slice(bytes);
                Self::from_le_bytes(exact)
            }
        }
    };
}
element!(f32, "<f4", "little-endian float32");
element!(f64, "<f8", "little-endian float64");
element!(u8, "|u1", "8-bit unsigned integers");

/// Largest file that is read, bytes: an array of 8192×8192 float32 and its header. Larger: a mistake
/// fills the memory. Smaller: the truth of the largest images is refused.
const MAX_BYTES: u64 = (256 << 20) + MAX_HEADER_BYTES;

/// Longest header, bytes: the format's magic, version and length, and what the length can say.
const MAX_HEADER_BYTES: u64 = 10 + 0xffff;

/// Values that are converted at a time. Larger: memory; smaller: calls.
const CHUNK: usize = 1 << 14;

/// Reads an array of `AXES` axes: its shape, and its values with the last axis running fastest. An
/// error for another type, Fortran's order, another number of axes, a truncated file, one that is no
/// regular file, or one of more than 256 MiB; all are found before the values are read.
pub fn read_npy<T: Element, const AXES: usize>(
    path: &Path,
) -> Result<([usize; AXES], Vec<T>), NpyError> {
    let failed = |source| NpyError::Read { path: path.to_owned(), source };
    let wrong = |reason: &str| NpyError::Content { path: path.to_owned(), reason: reason.into() };
    let (mut file, length) = open_bounded(path, MAX_BYTES).map_err(failed)?;
    let mut start = Vec::new();
    (&mut file).take(MAX_HEADER_BYTES).read_to_end(&mut start).map_err(failed)?;
    let (header_bytes, shape) = header::<T, AXES>(&start).map_err(|reason| wrong(&reason))?;
    let data_bytes = length.checked_sub(header_bytes as u64);
    let size = shape.iter().try_fold(T::BYTES, |size, n| size.checked_mul(*n));
    let Some(size) = size.filter(|size| Some(*size as u64) == data_bytes) else {
        return Err(wrong("has another size than its header says"));
    };
    file.seek(SeekFrom::Start(header_bytes as u64)).map_err(failed)?;
    let mut values = Vec::with_capacity(size / T::BYTES);
    let mut chunk = vec![0; CHUNK * T::BYTES];
    let mut left = size;
    while left > 0 {
        let bytes = left.min(chunk.len());
        file.read_exact(&mut chunk[..bytes]).map_err(failed)?;
        values.extend(chunk[..bytes].chunks_exact(T::BYTES).map(T::from_le));
        left -= bytes;
    }
    Ok((shape, values))
}

/// The length of all that stands before the data, bytes, and the shape; the error is a reason.
fn header<T: Element, const AXES: usize>(start: &[u8]) -> Result<(usize, [usize; AXES]), String> {
    let rest = start.strip_prefix(b"\x93NUMPY\x01\x00").ok_or("is no npy file")?;
    let (length, rest) = rest.split_first_chunk().ok_or("is cut short")?;
    let length = usize::from(u16::from_le_bytes(*length));
    let header = rest.get(..length).ok_or("is cut short")?;
    let header = std::str::from_utf8(header).map_err(|_| "has no readable header")?;
    if !header.contains(&format!("'{}'", T::DESCR)) || !header.contains("'fortran_order': False") {
        return Err(format!("must hold {} in C order", T::NAME));
    }
    let shape: Vec<usize> = header
        .split_once('(')
        .and_then(|(_, rest)| rest.split_once(')'))
        .map(|(shape, _)| shape.split(',').filter_map(|n| n.trim().parse().ok()).collect())
        .unwrap_or_default();
    let shape = shape.try_into().map_err(|_| format!("must have {AXES} axes"))?;
    Ok((start.len() - rest.len() + length, shape))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A file as numpy writes it.
    pub(crate) fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let mut header =
            format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
        while (header.len() + 11) % 64 != 0 {
            header.push(' ');
        }
        header.push('\n');
        let mut file = b"\x93NUMPY\x01\x00".to_vec();
        file.extend(u16::try_from(header.len()).unwrap().to_le_bytes());
        file.extend(header.as_bytes());
        file.extend(data);
        file
    }

    #[test]
    fn an_array_is_read_and_a_wrong_one_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let data: Vec<u8> = (0..6).flat_map(|i| f64::from(i).to_le_bytes()).collect();
        std::fs::write(&path, npy("<f8", "1, 3, 2", &data)).unwrap();
        let (shape, values) = read_npy::<f64, 3>(&path).unwrap();
        assert_eq!((shape, values), ([1, 3, 2], vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]));

        let complaint = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            read_npy::<f64, 3>(&path).unwrap_err().to_string()
        };
        assert!(complaint(b"text").ends_with("is no npy file"));
        assert!(complaint(&npy("<f4", "1, 3, 2", &data)).ends_with("float64 in C order"));
        assert!(complaint(&npy("<f8", "3, 2", &data)).ends_with("must have 3 axes"));
        assert!(complaint(&npy("<f8", "1, 3, 3", &data)).contains("another size"));
        let huge = format!("{}, {}, 2", usize::MAX, usize::MAX);
        assert!(complaint(&npy("<f8", &huge, &data)).contains("another size"));
        assert!(complaint(&npy("<f8", "1, 3, 2", &data)[..40]).ends_with("is cut short"));
    }
}
