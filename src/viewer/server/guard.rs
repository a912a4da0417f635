//! Who may speak to the server.
//!
//! - A page of another site, even one whose name was made to point here (DNS rebinding), is refused by `Host`,
//!   `Origin` and `Sec-Fetch-Site`.
//! - Beyond this machine, everything needs a token: in the address at first, in a cookie from then on.
//! - Every answer says that the page may load nothing from elsewhere and be framed by nobody.

use super::answer::Failure;
use crate::{Error, Result};
use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, Method, StatusCode, header},
    middleware::Next,
    response::{IntoResponse, Response},
};
use std::{
    net::{IpAddr, SocketAddr},
    sync::Arc,
};

/// Decides about requests.
pub(super) struct Guard {
    bound: SocketAddr,
    /// For whoever comes from outside.
    token: Option<String>,
}

/// What the page may do.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; \
    connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

impl Guard {
    /// # Errors
    /// When the system gives no random numbers for a token.
    pub(super) fn new(bound: SocketAddr, needs_token: bool) -> Result<Self> {
        let token = needs_token.then(random_token).transpose()?;
        Ok(Self { bound, token })
    }

    /// The address of the page.
    pub(super) fn url(&self) -> String {
        let (ip, port) = (self.bound.ip(), self.bound.port());
        // An address that stands for all of them is none to go to.
        let host = match (ip.is_unspecified(), ip) {
            (true, _) => "localhost".to_string(),
            (false, IpAddr::V6(ip)) => format!("[{ip}]"),
            (false, IpAddr::V4(ip)) => ip.to_string(),
        };
        match &self.token {
            Some(token) => format!("http://{host}:{port}/?token={token}"),
            None => format!("http://{host}:{port}/"),
        }
    }

    /// Whether the server is called by a name of its own. Only addresses are, and `localhost`: any other name could
    /// be anybody's.
    fn is_host(&self, host: &str) -> bool {
        let (name, port) = match host.rsplit_once(':') {
            Some((name, port)) if !port.ends_with(']') => (name, port.parse().ok()),
            _ => (host, Some(80)),
        };
        let name = name.trim_start_matches('[').trim_end_matches(']');
        let is_known = match name.parse::<IpAddr>() {
            Ok(ip) => self.token.is_some() || ip.is_loopback(),
            Err(_) => name.eq_ignore_ascii_case("localhost"),
        };
        is_known && port == Some(self.bound.port())
    }

    fn refusal(&self, request: &Request) -> Option<Failure> {
        let headers = request.headers();
        let host = text(headers, &header::HOST);
        if !host.is_some_and(|host| self.is_host(host)) {
            return Some(Failure::new(
                StatusCode::FORBIDDEN,
                "this server does not go by that name",
                format!("open {}", self.bound),
            ));
        }
        let origin = headers.get(header::ORIGIN).map(HeaderValue::as_bytes);
        let own = format!("http://{}", host.unwrap_or_default());
        let site = headers.get("sec-fetch-site").map(HeaderValue::as_bytes);
        let is_foreign = origin.is_some_and(|origin| origin != own.as_bytes())
            || site.is_some_and(|site| !matches!(site, b"same-origin" | b"none"));
        // Whoever follows a link comes to the page, and tells it nothing.
        let visits = request.method() == Method::GET
            && request.uri().path() == "/"
            && headers
                .get("sec-fetch-mode")
                .is_some_and(|m| m == "navigate");
        (is_foreign && !visits).then(|| {
            Failure::new(
                StatusCode::FORBIDDEN,
                "the request comes from another site",
                "open the page itself",
            )
        })
    }

    fn cookie_name(&self) -> String {
        // Cookies do not tell ports apart.
        format!("tid3r-{}", self.bound.port())
    }

    fn has_cookie(&self, headers: &HeaderMap, token: &str) -> bool {
        let name = self.cookie_name();
        let cookies = headers.get_all(header::COOKIE).iter();
        let mut pairs = cookies
            .filter_map(|value| value.to_str().ok())
            .flat_map(|value| value.split(';'))
            .filter_map(|pair| pair.trim().split_once('='));
        pairs.any(|(key, value)| key == name && same(value, token))
    }

    /// Sends a visitor with the token on, without it in the address.
    fn welcome(&self, request: &Request, token: &str) -> Option<Response> {
        let query = request.uri().query()?;
        let given = query
            .split('&')
            .find_map(|pair| pair.strip_prefix("token="))?;
        let name = self.cookie_name();
        (request.uri().path() == "/" && same(given, token)).then(|| {
            let cookie = format!("{name}={token}; Path=/; HttpOnly; SameSite=Strict");
            let headers = [
                (header::LOCATION, "/".to_string()),
                (header::SET_COOKIE, cookie),
            ];
            (StatusCode::SEE_OTHER, headers).into_response()
        })
    }
}

/// Lets a request through to the routes, or refuses it.
pub(super) async fn check(
    State(guard): State<Arc<Guard>>,
    request: Request,
    next: Next,
) -> Response {
    let mut response = if let Some(refusal) = guard.refusal(&request) {
        refusal.into_response()
    } else {
        match &guard.token {
            Some(token) if !guard.has_cookie(request.headers(), token) => {
                guard.welcome(&request, token).unwrap_or_else(|| {
                    let problem = "this server speaks to nobody without its token";
                    let remedy = "open the whole address that `tid3r view` printed";
                    Failure::new(StatusCode::UNAUTHORIZED, problem, remedy).into_response()
                })
            }
            _ => next.run(request).await,
        }
    };
    let headers = response.headers_mut();
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::X_FRAME_OPTIONS, "DENY"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    for name in ["cross-origin-opener-policy", "cross-origin-resource-policy"] {
        headers.insert(name, HeaderValue::from_static("same-origin"));
    }
    headers
        .entry(header::CACHE_CONTROL)
        .or_insert(HeaderValue::from_static("no-store"));
    response
}

fn text<'a>(headers: &'a HeaderMap, name: &header::HeaderName) -> Option<&'a str> {
    headers.get(name)?.to_str().ok()
}

/// Compares without telling by the time it takes where the first difference is.
fn same(given: &str, token: &str) -> bool {
    let (given, token) = (given.as_bytes(), token.as_bytes());
    let pairs = given.iter().zip(token);
    let differences = pairs.fold(0, |all, (a, b)| all | (a ^ b));
    given.len() == token.len() && std::hint::black_box(differences) == 0
}

fn random_token() -> Result<String> {
    let mut bytes = [0_u8; 16];
    getrandom::fill(&mut bytes).map_err(|error| {
        let problem = format!("the system gives no random numbers ({error})");
        Error::request(problem, "view the scene without --host")
    })?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guard(address: &str, needs_token: bool) -> Guard {
        Guard::new(address.parse().unwrap(), needs_token).unwrap()
    }

    #[test]
    fn only_addresses_and_localhost_are_names_of_the_server() {
        let local = guard("127.0.0.1:8080", false);
        for host in [
            "127.0.0.1:8080",
            "localhost:8080",
            "LOCALHOST:8080",
            "[::1]:8080",
        ] {
            assert!(local.is_host(host), "{host}");
        }
        for host in [
            "localhost",
            "127.0.0.1:80",
            "evil.example:8080",
            "localhost.evil.example:8080",
            "192.168.0.7:8080",
            "",
            ":8080",
            "127.0.0.1:8080:8080",
            "[::1]",
        ] {
            assert!(!local.is_host(host), "{host}");
        }
        let open = guard("0.0.0.0:8080", true);
        assert!(open.is_host("192.168.0.7:8080") && !open.is_host("evil.example:8080"));
    }

    #[test]
    fn tokens_are_long_differ_and_compare_whole() {
        let [a, b] = [(); 2].map(|()| random_token().unwrap());
        assert!(a.len() == 32 && a != b);
        assert!(same(&a, &a) && !same(&a[1..], &a) && !same("", &a) && !same(&b, &a));
        assert!(
            guard("0.0.0.0:1", true)
                .url()
                .starts_with("http://localhost:1/?token=")
        );
        assert_eq!(guard("[::1]:1", false).url(), "http://[::1]:1/");
    }
}
