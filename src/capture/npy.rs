//! Arrays of float32 in numpy's file format, version 1: C order, little-endian, two axes.

use super::TruthError;
use crate::host::read_bytes;
use std::path::Path;

/// Largest file that is read, bytes: an array of 8192×8192 and its header.
const MAX_BYTES: u64 = (256 << 20) + 10 + 0xffff;

/// Reads an array of H×W: its width, its height, and its values row by row.
///
/// # Errors
/// For another type, Fortran's order, another number of axes, or a size that the header contradicts.
pub fn read_array(path: &Path) -> Result<(usize, usize, Vec<f32>), TruthError> {
    let bytes = read_bytes(path, MAX_BYTES)
        .map_err(|source| TruthError::Read { path: path.to_owned(), source })?;
    parsed(&bytes).map_err(|reason| TruthError::Content { path: path.to_owned(), reason })
}

/// The error is a reason.
fn parsed(file: &[u8]) -> Result<(usize, usize, Vec<f32>), String> {
    let rest = file.strip_prefix(b"\x93NUMPY\x01\x00").ok_or("is no npy file")?;
    let (length, rest) = rest.split_first_chunk().ok_or("is cut short")?;
    let (header, data) =
        rest.split_at_checked(u16::from_le_bytes(*length).into()).ok_or("is cut short")?;
    let header = std::str::from_utf8(header).map_err(|_| "has no readable header")?;
    if !header.contains("'<f4'") || !header.contains("'fortran_order': False") {
        return Err("must hold little-endian float32 in C order".into());
    }
    let shape: Vec<usize> = header
        .split_once('(')
        .and_then(|(_, rest)| rest.split_once(')'))
        .map(|(shape, _)| shape.split(',').filter_map(|n| n.trim().parse().ok()).collect())
        .unwrap_or_default();
    let &[height, width] = shape.as_slice() else { return Err("must have 2 axes".into()) };
    let (values, tail) = data.as_chunks();
    if height.checked_mul(width) != Some(values.len()) || !tail.is_empty() {
        return Err("has another size than its header says".into());
    }
    Ok((width, height, values.iter().map(|value| f32::from_le_bytes(*value)).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file as numpy writes it.
    fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
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
        let data: Vec<u8> = (0..6).flat_map(|i| (i as f32).to_le_bytes()).collect();
        std::fs::write(&path, npy("<f4", "3, 2", &data)).unwrap();
        let values = vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
        assert_eq!(read_array(&path).unwrap(), (2, 3, values));

        let complaint = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            read_array(&path).unwrap_err().to_string()
        };
        assert!(complaint(b"text").ends_with("is no npy file"));
        assert!(complaint(&npy("<f8", "3, 2", &data)).ends_with("float32 in C order"));
        assert!(complaint(&npy("<f4", "1, 3, 2", &data)).ends_with("must have 2 axes"));
        assert!(complaint(&npy("<f4", "3, 3", &data)).contains("another size"));
        assert!(complaint(&npy("<f4", "3, 2", &data[1..])).contains("another size"));
        let huge = format!("{}, {}", usize::MAX, usize::MAX);
        assert!(complaint(&npy("<f4", &huge, &data)).contains("another size"));
        assert!(complaint(&npy("<f4", "3, 2", &data)[..40]).ends_with("is cut short"));
    }
}
