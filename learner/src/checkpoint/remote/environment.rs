//! Looks at the variables that a store's client reads before the client does, which panics over some values.

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

fn problem(name: &str, value: &str) -> Option<&'static str> {
    // Google's may be whole documents.
    let is_sent_as_it_is = !name.starts_with("GOOGLE_");
    if is_sent_as_it_is && !value.chars().all(|c| c.is_ascii_graphic() || c == ' ') {
        return Some("holds a line break or another character that cannot be sent; write it anew");
    }
    let is_address = name.contains("ENDPOINT") && !name.contains("STYLE") && !name.contains("USE_");
    // An empty one and a switch are not addresses.
    if !is_address || value.is_empty() || matches!(value, "true" | "false" | "1" | "0") {
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
        ] {
            assert_eq!(problem(name, value), None, "{name}={value:?}");
        }
    }
}
