//! Mutations of a file: bytes, pieces, and the numbers and words that parsers trip over.

use crate::common::random;
use stlfr::random::Random;

/// Numbers at the ends of every scale, and words out of place.
const TOKENS: [&str; 24] = [
    "0",
    "-1",
    "1",
    "1e308",
    "-1e308",
    "1e-308",
    "1e999",
    "NaN",
    "Infinity",
    "null",
    "true",
    "\"\"",
    "[]",
    "{}",
    "4294967296",
    "18446744073709551616",
    "-9223372036854775809",
    "0.1",
    "\"../x\"",
    "\"%n%s\"",
    "\u{0}",
    "é",
    "\n\n",
    "%99999999d",
];

pub struct Mutator {
    random: Random,
}

impl Mutator {
    pub fn new(seed: u64) -> Self {
        Self { random: Random::new(seed) }
    }

    fn below(&mut self, n: usize) -> usize {
        random::below(&mut self.random, n)
    }

    /// The file with one to four changes.
    pub fn mutated(&mut self, seed: &[u8], is_text: bool) -> Vec<u8> {
        let mut bytes = seed.to_vec();
        for _ in 0..1 + self.below(4) {
            match self.below(if is_text { 7 } else { 5 }) {
                0 => self.flip(&mut bytes),
                1 => self.cut(&mut bytes),
                2 => self.repeat(&mut bytes),
                3 => self.word(&mut bytes),
                4 => bytes.truncate(self.below(bytes.len() + 1)),
                _ => self.token(&mut bytes),
            }
        }
        bytes
    }

    fn flip(&mut self, bytes: &mut [u8]) {
        let at = self.below(bytes.len());
        let bit = self.below(8);
        if let Some(byte) = bytes.get_mut(at) {
            *byte ^= 1 << bit;
        }
    }

    fn piece(&mut self, len: usize) -> std::ops::Range<usize> {
        let start = self.below(len);
        let length = self.below(32.min(len - start.min(len)) + 1);
        start..(start + length).min(len)
    }

    fn cut(&mut self, bytes: &mut Vec<u8>) {
        let piece = self.piece(bytes.len());
        bytes.drain(piece);
    }

    fn repeat(&mut self, bytes: &mut Vec<u8>) {
        let piece = self.piece(bytes.len());
        let copy = bytes[piece.clone()].to_vec();
        let at = self.below(bytes.len() + 1);
        bytes.splice(at..at, copy);
    }

    /// A little-endian number at an end of its range.
    fn word(&mut self, bytes: &mut [u8]) {
        let values =
            [0, 1, u64::MAX, i64::MAX as u64, u64::from(u32::MAX), f64::NAN.to_bits(), 1 << 40];
        let value = values[self.below(values.len())].to_le_bytes();
        let size = [1, 2, 4, 8][self.below(4)];
        let at = self.below(bytes.len());
        for (byte, v) in bytes.iter_mut().skip(at).zip(&value[..size]) {
            *byte = *v;
        }
    }

    /// A number or word of a text in place of another.
    fn token(&mut self, bytes: &mut Vec<u8>) {
        let is_part = |b: u8| b.is_ascii_alphanumeric() || b"+-._\"".contains(&b);
        let at = self.below(bytes.len());
        if bytes.get(at).is_none_or(|b| !is_part(*b)) {
            return;
        }
        let start = bytes[..at].iter().rposition(|b| !is_part(*b)).map_or(0, |k| k + 1);
        let end = bytes[at..].iter().position(|b| !is_part(*b)).map_or(bytes.len(), |k| at + k);
        let token = TOKENS[self.below(TOKENS.len())];
        bytes.splice(start..end, token.bytes());
    }
}
