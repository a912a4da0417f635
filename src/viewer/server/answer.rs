//! Answers: JSON, files, and what went wrong.

use crate::{Error, Result};
use axum::{
    body::{self, Body, Bytes},
    extract::{FromRequest, Request},
    http::{HeaderName, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::{Serialize, de::DeserializeOwned};
use serde_json::json;
use tid3r_weights_convert::Error as OfWeights;

/// Why there is no other answer.
#[derive(Debug)]
pub(super) struct Failure {
    status: StatusCode,
    problem: String,
    remedy: String,
}

impl Failure {
    pub(super) fn new(
        status: StatusCode,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self {
            status,
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// For what there is not.
    pub(super) fn missing(what: &str) -> Self {
        let problem = format!("there is no {what}");
        Self::new(StatusCode::NOT_FOUND, problem, "reload the page")
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        match error {
            Error::Request { problem, remedy }
            | Error::Weights(OfWeights::Request { problem, remedy }) => {
                Self::new(StatusCode::UNPROCESSABLE_ENTITY, problem, remedy)
            }
            Error::File {
                path,
                problem,
                remedy,
            }
            | Error::Weights(OfWeights::File {
                path,
                problem,
                remedy,
            }) => {
                let problem = format!("{}: {problem}", path.display());
                Self::new(StatusCode::CONFLICT, problem, remedy)
            }
            other => Self::new(
                StatusCode::INTERNAL_SERVER_ERROR,
                other.to_string(),
                "put it right and try again",
            ),
        }
    }
}

impl IntoResponse for Failure {
    fn into_response(self) -> Response {
        let content = json!({ "problem": self.problem, "remedy": self.remedy });
        (self.status, [JSON], content.to_string()).into_response()
    }
}

const JSON: (HeaderName, &str) = (header::CONTENT_TYPE, "application/json");

/// What a route gives.
pub(super) type Answer = Result<Response, Failure>;

/// A value as JSON.
pub(super) fn json_of(value: &impl Serialize) -> Answer {
    let text = serde_json::to_string(value).map_err(|error| {
        let problem = format!("the answer cannot be written ({error})");
        Failure::from(Error::request(problem, "report this as a defect"))
    })?;
    Ok(([JSON], text).into_response())
}

/// Bytes that never change under their address.
pub(super) fn lasting(kind: &'static str, content: impl Into<Body>) -> Response {
    let headers = [
        (header::CONTENT_TYPE, kind),
        (
            header::CACHE_CONTROL,
            "private, max-age=31536000, immutable",
        ),
    ];
    (headers, content.into()).into_response()
}

/// Runs what blocks on another thread; a panic in it is an answer like others.
pub(super) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Failure> + Send + 'static,
) -> Result<T, Failure> {
    tokio::task::spawn_blocking(work).await.unwrap_or_else(|_| {
        Err(Failure::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "the program made a mistake; the scene is whole",
            "report this as a defect",
        ))
    })
}

/// No request is longer.
const LONGEST: usize = 256 * 1024;

/// What a request brings as JSON.
pub(super) struct Sent<T>(pub(super) T);

impl<S: Sync, T: DeserializeOwned> FromRequest<S> for Sent<T> {
    type Rejection = Failure;

    async fn from_request(request: Request, _: &S) -> Result<Self, Failure> {
        let kind = request.headers().get(header::CONTENT_TYPE);
        // Other sites cannot send this kind without asking first.
        if kind.is_none_or(|kind| kind != "application/json") {
            return Err(Failure::new(
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                "the request is not of the type application/json",
                "send JSON",
            ));
        }
        let read = body::to_bytes(request.into_body(), LONGEST).await;
        let bytes: Bytes = read.map_err(|_| {
            Failure::new(
                StatusCode::PAYLOAD_TOO_LARGE,
                format!("the request is broken off, or longer than {LONGEST} bytes"),
                "send less",
            )
        })?;
        let value = serde_json::from_slice(&bytes).map_err(|error| {
            Failure::new(
                StatusCode::BAD_REQUEST,
                format!("the request is not what it should be ({error})"),
                "reload the page",
            )
        })?;
        Ok(Self(value))
    }
}
