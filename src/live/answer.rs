//! Responses, all with the same headers.

use super::queue::Answer;
use super::{LiveError, Picture};
use crate::light_field::RenderError;
use http_body_util::Full;
use hyper::body::Bytes;
use hyper::http::{HeaderValue, header};
use hyper::{Response, StatusCode};

pub(super) type Reply = Response<Full<Bytes>>;

/// Content security policy: no other origins, no inline scripts or styles, no framing.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
                      require-trusted-types-for 'script'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The headers of every response.
const HEADERS: [(header::HeaderName, &str); 8] = [
    (header::CONTENT_SECURITY_POLICY, POLICY),
    (header::CACHE_CONTROL, "no-store"),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    // The address holds the token.
    (header::REFERRER_POLICY, "no-referrer"),
    (header::HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (header::HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    (
        header::HeaderName::from_static("permissions-policy"),
        "camera=(), microphone=(), geolocation=()",
    ),
];

/// Header: rendering time of a picture, milliseconds.
const MILLISECONDS: header::HeaderName = header::HeaderName::from_static("x-milliseconds");
/// Header: the methods of a picture.
const MADE_BY: header::HeaderName = header::HeaderName::from_static("x-made-by");

pub(super) fn respond(
    status: StatusCode,
    media_type: &'static str,
    body: impl Into<Bytes>,
) -> Reply {
    let mut response = Response::new(Full::new(body.into()));
    *response.status_mut() = status;
    let headers = response.headers_mut();
    for (name, value) in HEADERS {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(media_type));
    response
}

/// A response of one sentence.
pub(super) fn sentence(status: StatusCode, sentence: impl Into<String>) -> Reply {
    respond(status, "text/plain; charset=utf-8", sentence.into())
}

pub(super) fn failed(error: &LiveError) -> Reply {
    let status = match error {
        LiveError::Request(_) => StatusCode::BAD_REQUEST,
        LiveError::Superseded => StatusCode::CONFLICT,
        LiveError::Busy => StatusCode::SERVICE_UNAVAILABLE,
        LiveError::Panicked
        | LiveError::ImageFile(_)
        | LiveError::Render(RenderError::Capture(_)) => StatusCode::INTERNAL_SERVER_ERROR,
        LiveError::Render(_) => StatusCode::UNPROCESSABLE_ENTITY,
    };
    sentence(status, error.to_string())
}

pub(super) fn picture(answer: Answer) -> Reply {
    let Picture { bytes, made_by, seconds } = match answer {
        Ok(picture) => picture,
        Err(error) => return failed(&error),
    };
    let mut response = respond(StatusCode::OK, "image/png", bytes);
    for (name, value) in [(MILLISECONDS, format!("{:.1}", 1e3 * seconds)), (MADE_BY, made_by)] {
        if let Ok(value) = HeaderValue::from_str(&value) {
            response.headers_mut().insert(name, value);
        }
    }
    response
}
