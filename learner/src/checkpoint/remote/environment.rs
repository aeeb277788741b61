//! Looks at the variables that a store's client reads before the client does, which panics over some values. Those that it
//! does not read are none of our business: other programs of the machine have theirs under the same beginnings.

use object_store::aws::AmazonS3ConfigKey;
use object_store::azure::AzureConfigKey;
use object_store::gcp::GoogleConfigKey;

/// The beginnings of the variables that belong to a scheme.
fn family(scheme: &str) -> &'static str {
    match scheme {
        "s3" => "AWS_",
        "gs" => "GOOGLE_",
        _ => "AZURE_",
    }
}

/// Refuses values that cannot be meant. A line break at the end of a secret is the usual one.
///
/// # Errors
/// A sentence that names the variable and never its value.
pub(super) fn check(scheme: &str) -> Result<(), String> {
    let variables = std::env::vars_os().filter_map(|(name, value)| {
        let name = name.into_string().ok().filter(|name| name.starts_with(family(scheme)))?;
        Some((name, value.into_string().unwrap_or_else(|_| "\0".to_owned())))
    });
    for (name, value) in variables {
        if let Some(problem) = problem(&name, &value) {
            return Err(format!("the variable {name} {problem}"));
        }
    }
    Ok(())
}

/// What the client makes of a variable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Use {
    /// The URL of a service.
    Address,
    /// A part of requests.
    Sent,
    /// The name of a file, or a whole document.
    Free,
}

/// `None` for a variable that the client does not read. The client's own parser of names decides, with its other spellings.
fn use_of(name: &str) -> Option<Use> {
    let key = name.to_ascii_lowercase();
    let is_address = match name.split_once('_')?.0 {
        "AWS" => {
            use AmazonS3ConfigKey as Key;
            let addresses = [
                Key::Endpoint,
                Key::S3Endpoint,
                Key::StsEndpoint,
                Key::MetadataEndpoint,
                Key::ContainerCredentialsFullUri,
            ];
            addresses.contains(&key.parse().ok()?)
        }
        "AZURE" => [AzureConfigKey::Endpoint, AzureConfigKey::MsiEndpoint].contains(&key.parse().ok()?),
        _ => key.parse::<GoogleConfigKey>().ok()? == GoogleConfigKey::BaseUrl,
    };
    Some(if is_address {
        Use::Address
    } else if name.starts_with("GOOGLE_") || name.ends_with("_FILE") {
        Use::Free
    } else {
        Use::Sent
    })
}

fn problem(name: &str, value: &str) -> Option<&'static str> {
    let meaning = use_of(name)?;
    if meaning != Use::Free && !value.chars().all(|c| c.is_ascii_graphic() || c == ' ') {
        return Some("holds a line break or another character that cannot be sent; write it anew");
    }
    if meaning != Use::Address || value.is_empty() {
        return None;
    }
    let is_good = url::Url::parse(value)
        .is_ok_and(|url| matches!(url.scheme(), "http" | "https") && url.has_host() && !value.contains(' '));
    (!is_good).then_some("is no address; it must be http://HOST:PORT or https://HOST:PORT")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_make_a_client_panic_are_refused() {
        for (name, value) in [
            ("AWS_ACCESS_KEY_ID", "key\n"),
            ("AWS_SESSION_TOKEN", "a\tb"),
            ("AWS_REGION", "eu\u{fc}"),
            ("AWS_ENDPOINT_URL", "nonsense"),
            ("AWS_ENDPOINT", "http://"),
            ("AWS_ENDPOINT_URL_S3", "http://[::1"),
            ("AWS_ENDPOINT_URL", "http://a b"),
            ("AWS_ENDPOINT_URL", "http://a:99999"),
            ("AWS_ENDPOINT_URL_STS", "regional"),
            ("AWS_METADATA_ENDPOINT", "nonsense"),
            ("AZURE_STORAGE_ENDPOINT", "nonsense"),
            ("AZURE_STORAGE_ACCOUNT_KEY", "key\n"),
            ("GOOGLE_BASE_URL", "nonsense"),
        ] {
            assert!(problem(name, value).is_some(), "{name}={value:?}");
        }
        for (name, value) in [
            ("AWS_SECRET_ACCESS_KEY", "a+b/c=="),
            ("AWS_ENDPOINT_URL", "http://127.0.0.1:9000"),
            ("AWS_ENDPOINT_URL", ""),
            ("AZURE_STORAGE_ENDPOINT", "https://account.blob.core.windows.net"),
            ("GOOGLE_SERVICE_ACCOUNT_KEY", "{\n}\n"),
            ("AZURE_USE_FABRIC_ENDPOINT", "true"),
            // Standard on the clouds' own machines, and no addresses.
            ("AWS_STS_REGIONAL_ENDPOINTS", "regional"),
            ("AWS_S3_US_EAST_1_REGIONAL_ENDPOINT", "regional"),
            ("AWS_EC2_METADATA_SERVICE_ENDPOINT_MODE", "IPv4"),
            ("AWS_ACCOUNT_ID_ENDPOINT_MODE", "preferred"),
            // For other programs, or names of files.
            ("AWS_PROFILE", "J\u{fc}rgen"),
            ("AWS_CONFIG_FILE", "/home/j\u{fc}rgen/.aws/config"),
            ("AWS_WEB_IDENTITY_TOKEN_FILE", "/home/j\u{fc}rgen/token"),
        ] {
            assert_eq!(problem(name, value), None, "{name}={value:?}");
        }
    }
}
