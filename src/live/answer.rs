//! Builds HTTP responses. All responses have the same security headers.

use super::{LiveError, Picture};
use crate::light_field::RenderError;
use http_body_util::Full;
use hyper::body::Bytes;
use hyper::http::{HeaderValue, header};
use hyper::{Response, StatusCode};

pub(super) type Reply = Response<Full<Bytes>>;

/// Content security policy of the page: nothing from other origins, no inline scripts or styles, and no embedding in
/// other pages.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
                      require-trusted-types-for 'script'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// HTTP headers that every response has, beside its content type.
const HEADERS: [(header::HeaderName, &str); 8] = [
    (header::CONTENT_SECURITY_POLICY, POLICY),
    (header::CACHE_CONTROL, "no-store"),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    // The page's address contains the token, and must not be sent to other sites.
    (header::REFERRER_POLICY, "no-referrer"),
    (header::HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (header::HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    (
        header::HeaderName::from_static("permissions-policy"),
        "camera=(), microphone=(), geolocation=()",
    ),
];

/// Name of the HTTP header whose value is the names of the methods by which a picture was rendered.
const MADE_BY: header::HeaderName = header::HeaderName::from_static("x-made-by");

pub(super) fn respond(media_type: &'static str, body: impl Into<Bytes>) -> Reply {
    let mut response = Response::new(Full::new(body.into()));
    let headers = response.headers_mut();
    for (name, value) in HEADERS {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(media_type));
    response
}

/// Returns the response for an error: the error's sentence as plain text, with an HTTP status.
pub(super) fn failed(error: &LiveError) -> Reply {
    let mut response = respond("text/plain; charset=utf-8", error.to_string());
    *response.status_mut() = match error {
        LiveError::Request(_) => StatusCode::BAD_REQUEST,
        LiveError::Superseded => StatusCode::CONFLICT,
        LiveError::Busy => StatusCode::SERVICE_UNAVAILABLE,
        LiveError::Panicked
        | LiveError::ImageFile(_)
        | LiveError::Render(RenderError::Capture(_)) => StatusCode::INTERNAL_SERVER_ERROR,
        LiveError::Render(_) => StatusCode::UNPROCESSABLE_ENTITY,
        LiveError::Refused(status, _) => *status,
    };
    response
}

/// Name of the HTTP header that states the range of a picture's depth scale. Its value is the depths of the first and
/// the last colour of the scale, in metres, separated by a comma.
const DEPTHS: header::HeaderName = header::HeaderName::from_static("x-depths");

pub(super) fn picture(Picture { bytes, made_by, depths_m }: Picture) -> Reply {
    let mut response = respond("image/png", bytes);
    if let Ok(made_by) = HeaderValue::from_str(&made_by) {
        response.headers_mut().insert(MADE_BY, made_by);
    }
    // The number is written in a form that JavaScript can parse. Rust writes infinity as `inf`.
    let depth = |m: f32| if m.is_finite() { m.to_string() } else { "Infinity".to_owned() };
    let depths = depths_m.map(|m| HeaderValue::from_str(&m.map(depth).join(",")));
    if let Some(Ok(depths)) = depths {
        response.headers_mut().insert(DEPTHS, depths);
    }
    response
}
