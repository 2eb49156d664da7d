//! Access control: decides whether a request may be answered.

use super::LiveError;
use hyper::http::request::Parts;
use hyper::{Method, StatusCode, header};
use std::fs::File;
use std::io::Read;

/// Number of random bytes in the token of the page's address.
const TOKEN_BYTES: usize = 24;

/// Maximum length of a requested address, bytes. Longer addresses are refused.
const MAX_ADDRESS: usize = 1024;

/// The host names and the token by which requests are checked. Requests without them are refused.
pub(super) struct Guard {
    /// Secret token in the page's address: random bytes in hexadecimal digits.
    token: String,
    /// Accepted values of the header `Host`: `127.0.0.1:PORT` and `localhost:PORT`. For HTTP's default port also the
    /// names without port, which browsers then send.
    hosts: Vec<String>,
}

/// HTTP's default port, which browsers leave out of the header `Host`.
const HTTP_PORT: u16 = 80;

impl Guard {
    /// Creates a guard with a new token from the operating system's random generator.
    pub fn new(port: u16) -> std::io::Result<Self> {
        let mut bytes = [0; TOKEN_BYTES];
        File::open("/dev/urandom")?.read_exact(&mut bytes)?;
        let token = bytes.iter().map(|b| format!("{b:02x}")).collect();
        let names = ["127.0.0.1", "localhost"];
        let mut hosts = names.map(|name| format!("{name}:{port}")).to_vec();
        if port == HTTP_PORT {
            hosts.extend(names.map(String::from));
        }
        Ok(Self { token, hosts })
    }

    /// Returns the page's address, including the token.
    pub fn address(&self) -> String {
        format!("http://{}/{}/", self.hosts[0], self.token)
    }

    /// Returns whether a string is the token. The comparison takes constant time, so that its duration doesn't reveal
    /// the token.
    fn is_token(&self, given: &str) -> bool {
        let pairs = self.token.bytes().zip(given.bytes());
        given.len() == self.token.len() && pairs.fold(0, |wrong, (a, b)| wrong | (a ^ b)) == 0
    }

    /// Checks whether a request may be answered. Returns the part of the request's path after the token, which is empty
    /// for the page.
    ///
    /// # Errors
    /// If the request is refused.
    pub fn admit<'a>(&self, request: &'a Parts) -> Result<&'a str, LiveError> {
        let refused = |status, reason| Err(LiveError::Refused(status, reason));
        let field = |name: header::HeaderName| -> Result<Option<&str>, LiveError> {
            let mut all = request.headers.get_all(name).iter();
            match (all.next().map(|value| value.to_str()), all.next()) {
                (None, _) => Ok(None),
                (Some(Ok(value)), None) => Ok(Some(value)),
                _ => refused(StatusCode::BAD_REQUEST, "a header is wrong").map(Some),
            }
        };
        let host = field(header::HOST)?.unwrap_or_default();
        if !self.hosts.iter().any(|own| own == host) {
            return refused(StatusCode::MISDIRECTED_REQUEST, "this is another host's address");
        }
        if let Some(origin) = field(header::ORIGIN)?
            && origin.strip_prefix("http://") != Some(host)
        {
            return refused(StatusCode::FORBIDDEN, "another page may not ask");
        }
        if request.method != Method::GET {
            return refused(StatusCode::METHOD_NOT_ALLOWED, "only GET is answered");
        }
        let has_body = request.headers.contains_key(header::TRANSFER_ENCODING)
            || field(header::CONTENT_LENGTH)?.is_some_and(|length| length != "0");
        if has_body {
            return refused(StatusCode::PAYLOAD_TOO_LARGE, "a request has no body");
        }
        if request.uri.to_string().len() > MAX_ADDRESS {
            return refused(StatusCode::URI_TOO_LONG, "the address is too long");
        }
        let path = request.uri.path().strip_prefix('/').and_then(|path| path.split_once('/'));
        let Some((_, rest)) = path.filter(|(token, _)| self.is_token(token)) else {
            return Err(NOT_FOUND);
        };
        let site = request.headers.get("sec-fetch-site").map(|v| v.as_bytes());
        let is_own = matches!(site, None | Some(b"same-origin" | b"none"));
        // Any site may link to the page, but only the page itself may request the rest.
        if !is_own && !rest.is_empty() {
            return refused(StatusCode::FORBIDDEN, "another page may not ask");
        }
        Ok(rest)
    }
}

/// Error for a wrong token, and also for an unknown path. The response thus doesn't reveal whether the token is right.
pub(super) const NOT_FOUND: LiveError =
    LiveError::Refused(StatusCode::NOT_FOUND, "there is nothing at this address");

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_token_is_known_or_not() {
        let [guard, other] = [(); 2].map(|()| Guard::new(80).unwrap());
        let token = guard.token.as_str();
        assert_eq!(token.len(), 2 * TOKEN_BYTES);
        assert!(guard.is_token(token));
        let mut last = token.to_owned();
        let digit = if last.ends_with('0') { "1" } else { "0" };
        last.replace_range(last.len() - 1.., digit);
        for wrong in ["", &other.token, &token[1..], &last, &format!("{token}0")] {
            assert!(!guard.is_token(wrong), "{wrong}");
        }
    }

    /// Returns whether the page is served to a request with these headers `Host` and `Origin`.
    fn is_admitted(guard: &Guard, host: &str, origin: Option<&str>) -> bool {
        let mut request = hyper::Request::get(format!("/{}/", guard.token)).header("host", host);
        if let Some(origin) = origin {
            request = request.header("origin", origin);
        }
        guard.admit(&request.body(()).unwrap().into_parts().0).is_ok()
    }

    #[test]
    fn a_browser_leaves_out_port_80_and_no_other() {
        let [http, other] = [80, 8080].map(|port| Guard::new(port).unwrap());
        for name in ["127.0.0.1", "localhost"] {
            for host in [name.to_owned(), format!("{name}:80")] {
                assert!(is_admitted(&http, &host, None), "{host}");
                assert!(is_admitted(&http, &host, Some(&format!("http://{host}"))), "{host}");
                assert!(!is_admitted(&http, &host, Some("http://elsewhere")), "{host}");
            }
            assert!(is_admitted(&other, &format!("{name}:8080"), None));
            assert!(!is_admitted(&other, name, None) && !is_admitted(&http, "elsewhere", None));
        }
    }
}
