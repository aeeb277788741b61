//! Errors as gRPC carries them: a sentence for people, and google.rpc details for programs.
//!
//! Every error of the three services has an `ErrorInfo` with a [`Reason`] in domain [`DOMAIN`]. Bad fields come in a
//! `BadRequest`, and errors that pass by themselves say in a `RetryInfo` when to come again.

use crate::Violation;
use std::collections::HashMap;
use std::time::Duration;
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, FieldViolation, StatusExt as _};

/// Domain of the reasons.
pub const DOMAIN: &str = "cross.v1";

/// Longest sentence that a status carries, bytes; headers are bounded, and what a peer sent may be quoted in it.
const MAX_MESSAGE: usize = 1024;

macro_rules! reasons {
    ($($(#[$doc:meta])* $name:ident = $text:literal, $code:ident;)*) => {
        /// Why a call failed; stable names for programs.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum Reason { $($(#[$doc])* $name,)* }

        impl Reason {
            /// Every reason.
            pub const ALL: &[Self] = &[$(Self::$name,)*];

            /// Its name on the wire.
            #[must_use]
            pub fn as_str(self) -> &'static str {
                match self { $(Self::$name => $text,)* }
            }

            /// The gRPC code it comes with.
            #[must_use]
            pub fn code(self) -> Code {
                match self { $(Self::$name => Code::$code,)* }
            }
        }
    };
}

reasons! {
    /// Actor and learner speak different versions of this protocol.
    ProtocolMismatch = "PROTOCOL_MISMATCH", FailedPrecondition;
    /// The actor was started with a configuration whose environment or model differs from the learner's.
    ConfigMismatch = "CONFIG_MISMATCH", FailedPrecondition;
    /// The actor can run none of the run's scenarios.
    NoScenario = "NO_SCENARIO", FailedPrecondition;
    /// The learner takes no more work: it stops, or training is complete.
    Draining = "DRAINING", FailedPrecondition;
    /// As many actors as allowed are there already.
    TooManyActors = "TOO_MANY_ACTORS", ResourceExhausted;
    /// The caller has not joined, or its lease has ended; join again.
    NotJoined = "NOT_JOINED", FailedPrecondition;
    /// The caller joined an earlier session of the learner; join again.
    OldSession = "OLD_SESSION", FailedPrecondition;
    /// Another process joined under the same actor id.
    Superseded = "SUPERSEDED", Aborted;
    /// More messages are in flight than the limits allow.
    TooManyInFlight = "TOO_MANY_IN_FLIGHT", ResourceExhausted;
    /// The call carries no token, or another than the server's.
    Unauthenticated = "UNAUTHENTICATED", Unauthenticated;
    /// The caller's address begins more calls than it may; the details say when to come again.
    TooManyRequests = "TOO_MANY_REQUESTS", ResourceExhausted;
    /// As many calls as allowed are open already, streams included.
    TooManyStreams = "TOO_MANY_STREAMS", ResourceExhausted;
    /// A message is larger than the limit.
    MessageTooLarge = "MESSAGE_TOO_LARGE", ResourceExhausted;
    /// A field breaks a rule; the details name it.
    InvalidField = "INVALID_FIELD", InvalidArgument;
    /// A message came where the protocol has no place for it.
    UnexpectedMessage = "UNEXPECTED_MESSAGE", InvalidArgument;
    /// There is no such checkpoint.
    CheckpointNotFound = "CHECKPOINT_NOT_FOUND", NotFound;
    /// A checkpoint is there but cannot be read or written.
    CheckpointUnusable = "CHECKPOINT_UNUSABLE", DataLoss;
    /// Health is not told of a service of that name.
    UnknownService = "UNKNOWN_SERVICE", NotFound;
    /// The learner has no such method, or does not know the message's compression.
    Unsupported = "UNSUPPORTED", Unimplemented;
    /// The learner itself failed; its log tells more.
    Internal = "INTERNAL", Internal;
}

impl Reason {
    /// The reason of that name, if this version knows it.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|reason| reason.as_str() == name)
    }

    /// Whether the caller can go on after joining again (and waiting, if told so); otherwise a person must act first.
    #[must_use]
    pub fn heals(self) -> bool {
        match self {
            Self::ProtocolMismatch | Self::ConfigMismatch | Self::NoScenario | Self::Superseded => false,
            Self::Unauthenticated
            | Self::InvalidField
            | Self::UnexpectedMessage
            | Self::MessageTooLarge
            | Self::CheckpointNotFound
            | Self::CheckpointUnusable
            | Self::UnknownService
            | Self::Unsupported => false,
            Self::Draining | Self::TooManyActors | Self::NotJoined | Self::OldSession => true,
            Self::TooManyInFlight | Self::TooManyRequests | Self::TooManyStreams | Self::Internal => true,
        }
    }
}

/// A status with a reason and nothing else.
#[must_use]
pub fn error(reason: Reason, message: impl Into<String>) -> Status {
    with_details(reason, message.into(), HashMap::new(), None)
}

/// A status for something that passes: the caller may come again after `delay`.
#[must_use]
pub fn retry_after(reason: Reason, message: impl Into<String>, delay: Duration) -> Status {
    with_details(reason, message.into(), HashMap::new(), Some(delay))
}

/// INVALID_ARGUMENT that names the field; the sentence starts with it.
#[must_use]
pub fn invalid(violation: &Violation) -> Status {
    let reason = Reason::InvalidField;
    let mut details = details(reason, HashMap::new());
    details.set_bad_request(vec![FieldViolation::new(
        shortened(violation.field.clone()),
        shortened(violation.description.clone()),
    )]);
    Status::with_error_details(reason.code(), shortened(violation.to_string()), details)
}

impl From<Violation> for Status {
    fn from(violation: Violation) -> Self {
        invalid(&violation)
    }
}

/// The protocol versions differ.
#[must_use]
pub fn protocol_mismatch(actor: u32, learner: u32) -> Status {
    let message = format!(
        "the actor speaks protocol version {actor} and this learner version {learner}; install the same release of CROSS on both"
    );
    let metadata = [("actor".to_owned(), actor.to_string()), ("learner".to_owned(), learner.to_string())];
    with_details(Reason::ProtocolMismatch, message, metadata.into(), None)
}

/// The compatibility hashes differ.
#[must_use]
pub fn config_mismatch(actor: &str, learner: &str) -> Status {
    let actor = shortened(actor.to_owned());
    let message = format!(
        "the actor's configuration has hash {actor:?} and this learner's {learner:?}; \
         give both the same [env] and [model] sections, or let the actor take the learner's"
    );
    let metadata = [("actor".to_owned(), actor), ("learner".to_owned(), learner.to_owned())];
    with_details(Reason::ConfigMismatch, message, metadata.into(), None)
}

/// The learner is leaving; another one may be there after `delay`.
#[must_use]
pub fn draining(delay: Duration) -> Status {
    retry_after(Reason::Draining, "the learner is stopping and takes nothing new; come again later", delay)
}

/// The actor limit is reached.
#[must_use]
pub fn too_many_actors(limit: usize, delay: Duration) -> Status {
    let message =
        format!("{limit} actors have joined, which is the limit; stop one or raise learner.max_actors");
    let metadata = [("limit".to_owned(), limit.to_string())];
    with_details(Reason::TooManyActors, message, metadata.into(), Some(delay))
}

/// The caller's address has used up its calls; the next one is free after `delay`.
#[must_use]
pub fn too_many_requests(per_second: u32, delay: Duration) -> Status {
    let message = format!(
        "this address begins more than {per_second} calls a second; call less often, or raise learner.requests_per_second"
    );
    let metadata = [("limit".to_owned(), per_second.to_string())];
    with_details(Reason::TooManyRequests, message, metadata.into(), Some(delay))
}

/// The limit on open calls is reached.
#[must_use]
pub fn too_many_streams(limit: usize, delay: Duration) -> Status {
    let message = format!("{limit} calls are open, which is the limit; end one or raise learner.max_streams");
    let metadata = [("limit".to_owned(), limit.to_string())];
    with_details(Reason::TooManyStreams, message, metadata.into(), Some(delay))
}

/// A message is above the limit.
#[must_use]
pub fn message_too_large(limit: usize) -> Status {
    let message = format!(
        "a message is larger than {limit} bytes; send smaller ones, or raise learner.max_message_bytes"
    );
    let metadata = [("limit".to_owned(), limit.to_string())];
    with_details(Reason::MessageTooLarge, message, metadata.into(), None)
}

/// There is no checkpoint `id`.
#[must_use]
pub fn checkpoint_not_found(id: &str) -> Status {
    let id = shortened(id.to_owned());
    let message = format!("there is no checkpoint {id:?}; ListCheckpoints tells which there are");
    with_details(Reason::CheckpointNotFound, message, [("id".to_owned(), id)].into(), None)
}

/// Health is not told of `service`.
#[must_use]
pub fn unknown_service(service: &str) -> Status {
    let service = shortened(service.to_owned());
    let known = crate::service::ALL.join(", ");
    let message = format!(
        "there is no service {service:?}; leave the name out for the whole learner, or ask for one of {known}"
    );
    with_details(Reason::UnknownService, message, [("service".to_owned(), service)].into(), None)
}

/// There is no method `path`, written as `/package.Service/Method`.
#[must_use]
pub fn unknown_method(path: &str) -> Status {
    let method = shortened(path.trim_start_matches('/').to_owned());
    let message =
        format!("there is no method {method:?}; reflection and docs/protocol.md tell which there are");
    with_details(Reason::Unsupported, message, [("method".to_owned(), method)].into(), None)
}

/// The reason of a status, if it is one of ours.
#[must_use]
pub fn reason(status: &Status) -> Option<Reason> {
    let info = status.get_details_error_info().filter(|info| info.domain == DOMAIN)?;
    Reason::from_name(&info.reason)
}

/// The bad fields that a status names.
#[must_use]
pub fn violations(status: &Status) -> Vec<Violation> {
    let Some(request) = status.get_details_bad_request() else { return Vec::new() };
    request.field_violations.into_iter().map(|v| Violation::new(v.field, v.description)).collect()
}

/// After what time a status asks to come again.
#[must_use]
pub fn retry_delay(status: &Status) -> Option<Duration> {
    status.get_details_retry_info()?.retry_delay
}

fn with_details(
    reason: Reason,
    message: String,
    metadata: HashMap<String, String>,
    delay: Option<Duration>,
) -> Status {
    let mut details = details(reason, metadata);
    if delay.is_some() {
        details.set_retry_info(delay);
    }
    Status::with_error_details(reason.code(), shortened(message), details)
}

fn details(reason: Reason, metadata: HashMap<String, String>) -> ErrorDetails {
    ErrorDetails::with_error_info(reason.as_str(), DOMAIN, metadata)
}

/// Cuts text to what fits a header, at a character's end.
fn shortened(mut text: String) -> String {
    if text.len() > MAX_MESSAGE {
        let mut end = MAX_MESSAGE;
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        text.truncate(end);
        text.push_str("...");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the other side sees: through the headers that gRPC sends.
    fn transmitted(status: &Status) -> Status {
        let response = status.clone().into_http::<()>();
        Status::from_header_map(response.headers()).unwrap()
    }

    #[test]
    fn every_reason_reads_back() {
        for &expected in Reason::ALL {
            let status = transmitted(&error(expected, "something happened"));
            assert_eq!(reason(&status), Some(expected));
            assert_eq!(status.code(), expected.code());
            assert_eq!(status.message(), "something happened");
            assert_eq!(retry_delay(&status), None);
        }
    }

    #[test]
    fn names_are_upper_snake_case_and_distinct() {
        let mut names: Vec<_> = Reason::ALL.iter().map(|reason| reason.as_str()).collect();
        for name in &names {
            assert!(name.chars().all(|c| c.is_ascii_uppercase() || c == '_'), "{name}");
        }
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), Reason::ALL.len());
    }

    #[test]
    fn a_violation_is_named_in_words_and_in_the_details() {
        let violation = Violation::new("fragment.rewards", "has NaN");
        let status = transmitted(&Status::from(violation.clone()));
        assert_eq!(status.code(), Code::InvalidArgument);
        assert_eq!(reason(&status), Some(Reason::InvalidField));
        assert_eq!(status.message(), "fragment.rewards has NaN");
        assert_eq!(violations(&status), [violation]);
    }

    #[test]
    fn a_delay_reads_back() {
        let delay = Duration::from_millis(2500);
        let limits = [too_many_actors(3, delay), too_many_requests(3, delay), too_many_streams(3, delay)];
        for status in limits.into_iter().chain([draining(delay)]) {
            let status = transmitted(&status);
            assert_eq!(retry_delay(&status), Some(delay));
            assert!(reason(&status).is_some_and(Reason::heals));
        }
    }

    #[test]
    fn mismatches_name_both_sides_and_do_not_heal() {
        for status in [protocol_mismatch(7, 8), config_mismatch("7", "8")] {
            assert!(status.message().contains('7') && status.message().contains('8'), "{status}");
            assert_eq!(status.code(), Code::FailedPrecondition);
            assert!(!reason(&status).unwrap().heals());
        }
    }

    #[test]
    fn a_foreign_status_has_no_reason() {
        assert_eq!(reason(&Status::internal("x")), None);
        let details = ErrorDetails::with_error_info("DRAINING", "elsewhere.example", HashMap::new());
        assert_eq!(reason(&Status::with_error_details(Code::Aborted, "x", details)), None);
        assert!(violations(&Status::internal("x")).is_empty());
    }

    #[test]
    fn a_long_quotation_is_cut_at_a_character() {
        let long = "ä".repeat(100_000);
        for status in [checkpoint_not_found(&long), unknown_service(&long), unknown_method(&long)] {
            assert!(status.message().len() < 2 * MAX_MESSAGE, "{}", status.message().len());
            assert_eq!(transmitted(&status).message(), status.message());
        }
    }
}
