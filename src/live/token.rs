//! The secret part of an address.

use std::fs::File;
use std::io::{Read, Result};

/// Length of the random secret, bytes.
const BYTES: usize = 24;

/// A random secret in letters and digits.
pub(super) struct Token(String);

impl Token {
    /// A new secret from the operating system's random generator.
    pub fn new() -> Result<Self> {
        let mut bytes = [0; BYTES];
        File::open("/dev/urandom")?.read_exact(&mut bytes)?;
        Ok(Self(bytes.iter().map(|b| format!("{b:02x}")).collect()))
    }

    pub fn text(&self) -> &str {
        &self.0
    }

    /// Compares in constant time.
    pub fn is(&self, given: &str) -> bool {
        let pairs = self.0.bytes().zip(given.bytes());
        given.len() == self.0.len() && pairs.fold(0, |wrong, (a, b)| wrong | (a ^ b)) == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_known_or_not() {
        let [token, other] = [(); 2].map(|()| Token::new().unwrap());
        assert_eq!(token.text().len(), 2 * BYTES);
        assert!(token.is(token.text()));
        let mut last = token.text().to_owned();
        let digit = if last.ends_with('0') { "1" } else { "0" };
        last.replace_range(last.len() - 1.., digit);
        for wrong in ["", other.text(), &token.text()[1..], &last, &format!("{}0", token.text())] {
            assert!(!token.is(wrong), "{wrong}");
        }
    }
}
