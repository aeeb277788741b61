//! What an object store answers when it does not do what was asked, in words that say what to do.

use object_store::client::HttpError;

/// Why a store did not do what was asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StoreTrouble {
    /// Nobody answers, or the store itself fails: a later try may do.
    #[error("the store cannot be reached ({0}); check the address, the network and the store")]
    Unreachable(String),
    /// The credentials are wrong, or may not do this.
    #[error(
        "the store refuses these credentials ({0}); check them, and that they may list, read, write and delete there"
    )]
    Denied(String),
    /// There are no credentials.
    #[error("no credentials were found; set {0}")]
    NoCredentials(&'static str),
    /// The bucket or container does not exist.
    #[error("there is no such bucket; create it, or correct the URL")]
    NoBucket,
    /// The URL, or a variable that belongs to it, makes no sense.
    #[error("{0}")]
    Unusable(String),
    /// Anything else.
    #[error("the store answers: {0}")]
    Other(String),
}

/// What the three services call a bucket that is not there.
const NO_BUCKET: [&str; 3] = ["NoSuchBucket", "The specified bucket does not exist", "ContainerNotFound"];
/// Where credentials are asked for when the environment has none: the metadata services of the clouds.
const METADATA_SERVICES: [&str; 5] = [
    "169.254.169.254",
    "latest/api/token",
    "latest/meta-data",
    "metadata.google.internal",
    "computeMetadata",
];
/// Longest part of a store's own words that is shown.
const WORDS: usize = 200;

impl StoreTrouble {
    /// All labels of [`label`](Self::label).
    pub const LABELS: [&str; 4] = ["unreachable", "denied", "no_bucket", "other"];

    /// For metrics.
    #[must_use]
    pub fn label(&self) -> &'static str {
        match self {
            Self::Unreachable(_) => "unreachable",
            Self::Denied(_) | Self::NoCredentials(_) => "denied",
            Self::NoBucket => "no_bucket",
            Self::Unusable(_) | Self::Other(_) => "other",
        }
    }

    /// What an error of the client means. `credentials` says which variables would hold some.
    pub(super) fn of(error: &object_store::Error, credentials: &'static str) -> Self {
        let words = chain(error);
        let all = words.join(" ");
        if NO_BUCKET.iter().any(|name| all.contains(name)) {
            return Self::NoBucket;
        }
        if METADATA_SERVICES.iter().any(|address| all.contains(address)) {
            return Self::NoCredentials(credentials);
        }
        let own = || own_words(&all, words.last().map_or("", String::as_str));
        match error {
            object_store::Error::PermissionDenied { .. } | object_store::Error::Unauthenticated { .. } => {
                Self::Denied(own())
            }
            _ if all.contains("status code: 5") || is_transport(error) => Self::Unreachable(own()),
            _ if all.contains("scheme is not allowed") => Self::Unusable(
                "the store's address has no TLS; use https://, or allow http:// inside a network that you trust \
                 with AWS_ALLOW_HTTP=true"
                    .to_owned(),
            ),
            _ => Self::Other(own()),
        }
    }
}

/// An error's words and those of its causes, outermost first.
pub(super) fn chain(error: &dyn std::error::Error) -> Vec<String> {
    let mut words = vec![error.to_string()];
    let mut next = error.source();
    while let Some(cause) = next {
        words.push(cause.to_string());
        next = cause.source();
    }
    words
}

fn is_transport(error: &object_store::Error) -> bool {
    let mut next: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(cause) = next {
        // A refused scheme comes this way too, and no waiting mends it.
        if cause.is::<HttpError>() {
            return !chain(cause).join(" ").contains("scheme is not allowed");
        }
        next = cause.source();
    }
    false
}

/// The store's code, such as `AccessDenied`, where it sent one; else the innermost cause. Never a whole answer: those are many
/// lines, and may repeat what was signed.
fn own_words(all: &str, innermost: &str) -> String {
    let code = |open: &str, close: &str| Some(all.split_once(open)?.1.split_once(close)?.0.to_owned());
    let words = code("<Code>", "</Code>").unwrap_or_else(|| {
        let before_body = innermost.split(['<', '\n']).next().unwrap_or_default();
        before_body.trim().trim_end_matches(':').to_owned()
    });
    words.chars().take(WORDS).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn generic(text: &str) -> object_store::Error {
        object_store::Error::Generic { store: "S3", source: text.into() }
    }

    fn denied(text: &str) -> object_store::Error {
        object_store::Error::PermissionDenied { path: "p".to_owned(), source: text.into() }
    }

    #[test]
    fn every_answer_has_its_remedy_and_no_body_is_repeated() {
        let body =
            "403: <Error><Code>SignatureDoesNotMatch</Code><StringToSign>SECRET</StringToSign></Error>";
        for (error, part, label) in [
            (denied(body), "(SignatureDoesNotMatch)", "denied"),
            (generic("404: <Code>NoSuchBucket</Code>"), "no such bucket", "no_bucket"),
            (generic("http://169.254.169.254/latest"), "set AWS_X", "denied"),
            (generic("Server returned non-2xx status code: 503: <x>"), "cannot be reached", "unreachable"),
            (generic("odd\nSECRET"), "answers: odd", "other"),
        ] {
            let trouble = StoreTrouble::of(&error, "AWS_X");
            let text = trouble.to_string();
            assert!(text.contains(part) && !text.contains("SECRET") && !text.contains('\n'), "{text}");
            assert_eq!(trouble.label(), label, "{text}");
            assert!(StoreTrouble::LABELS.contains(&label));
        }
    }
}
