//! Bearer tokens: where they come from, how they are sent, and how they are compared.

use crate::error::SecurityError;
use crate::options::{TOKEN_VARIABLE, TokenOption, given};
use crate::pem::read_secret;
use sha2::{Digest, Sha256};
use std::fmt;
use subtle::ConstantTimeEq;
use tonic::Status;
use tonic::metadata::{Ascii, MetadataValue};

/// Shorter tokens are refused: they can be guessed.
const SHORTEST: usize = 16;
/// Longer ones do not fit a header in comfort.
const LONGEST: usize = 4096;

/// One token. It is shown nowhere.
#[derive(Clone)]
pub struct Token(String);

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(..)")
    }
}

impl Token {
    fn new(text: &str, origin: &str) -> Result<Self, SecurityError> {
        let problem = if text.len() < SHORTEST {
            format!(
                "has {} characters, fewer than {SHORTEST}; make one with: openssl rand -hex 32",
                text.len()
            )
        } else if text.len() > LONGEST {
            format!("has more than {LONGEST} characters; make one with: openssl rand -hex 32")
        } else if !text.bytes().all(|byte| byte.is_ascii_graphic()) {
            "has blanks or characters that a header cannot carry; use letters and digits".to_owned()
        } else {
            return Ok(Self(text.to_owned()));
        };
        Err(SecurityError::Token { origin: origin.to_owned(), problem })
    }
}

/// The tokens of a process: a server takes any of them, a client sends the first. Several let a token be changed without a
/// moment in which neither works.
#[derive(Debug, Clone)]
pub struct Tokens(Vec<Token>);

impl Tokens {
    /// Reads what the options and the variable `CROSS_TOKEN` (passed as `variable`) give; `None` if there is no token.
    ///
    /// A file holds one token a line; empty lines and lines that begin with `#` do not count.
    ///
    /// # Errors
    /// [`SecurityError`] if both are given, the file is everybody's to read, or a token cannot be used.
    pub fn load(option: &TokenOption, variable: Option<String>) -> Result<Option<Self>, SecurityError> {
        let variable = variable.filter(|text| !text.is_empty());
        let (text, origin) = match (given(option.token_file.as_ref()), variable) {
            (None, None) => return Ok(None),
            (Some(_), Some(_)) => return Err(SecurityError::TwoTokens),
            (None, Some(text)) => (text, format!("the variable {TOKEN_VARIABLE}")),
            (Some(path), None) => {
                let bytes = read_secret("--token-file", path)?;
                let origin = path.display().to_string();
                let text = String::from_utf8(bytes).map_err(|_| SecurityError::Token {
                    origin: origin.clone(),
                    problem: "is no text; make one with: openssl rand -hex 32".to_owned(),
                })?;
                (text, origin)
            }
        };
        let tokens = text
            .lines()
            .map(str::trim)
            .filter(|line| !line.is_empty() && !line.starts_with('#'))
            .map(|line| Token::new(line, &origin))
            .collect::<Result<Vec<_>, _>>()?;
        if tokens.is_empty() {
            let problem =
                "is missing: there is nothing in it; make one with: openssl rand -hex 32".to_owned();
            return Err(SecurityError::Token { origin, problem });
        }
        Ok(Some(Self(tokens)))
    }

    /// What the variable `CROSS_TOKEN` holds, for [`load`](Self::load).
    #[must_use]
    pub fn variable() -> Option<String> {
        std::env::var(TOKEN_VARIABLE).ok()
    }

    /// Whether the value of an `authorization` header carries one of the tokens.
    ///
    /// How long this takes tells nothing about a token: digests are compared, all of them, and each to its end.
    #[must_use]
    pub fn accepts(&self, authorization: Option<&[u8]>) -> bool {
        let Some(presented) = authorization.and_then(bearer) else { return false };
        let presented = Sha256::digest(presented);
        let mut found = subtle::Choice::from(0);
        for Token(token) in &self.0 {
            found |= Sha256::digest(token.as_bytes()).as_slice().ct_eq(presented.as_slice());
        }
        found.into()
    }

    /// The header's value that a client sends, marked as sensitive so that no library logs or indexes it.
    pub(crate) fn header(&self) -> Option<MetadataValue<Ascii>> {
        let Token(first) = self.0.first()?;
        // Only visible ASCII got this far.
        let mut value: MetadataValue<Ascii> = format!("Bearer {first}").parse().ok()?;
        value.set_sensitive(true);
        Some(value)
    }
}

/// What follows the word Bearer, which may be in any case.
fn bearer(value: &[u8]) -> Option<&[u8]> {
    let (scheme, token) = value.split_at_checked(7)?;
    scheme.eq_ignore_ascii_case(b"Bearer ").then_some(token)
}

/// Adds the token to every call of a client.
#[derive(Debug, Clone, Default)]
pub struct Bearer(pub(crate) Option<MetadataValue<Ascii>>);

impl tonic::service::Interceptor for Bearer {
    fn call(&mut self, mut request: tonic::Request<()>) -> Result<tonic::Request<()>, Status> {
        if let Some(value) = &self.0 {
            request.metadata_mut().insert("authorization", value.clone());
        }
        Ok(request)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;
    use std::path::Path;

    const TOKEN: &str = "0123456789abcdef0123";

    fn file(folder: &Path, text: &str, mode: u32) -> TokenOption {
        let path = folder.join("token");
        std::fs::write(&path, text).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
        TokenOption { token_file: Some(path) }
    }

    #[test]
    fn no_option_and_no_variable_is_no_token() {
        assert!(Tokens::load(&TokenOption::default(), None).unwrap().is_none());
        let empty = TokenOption { token_file: Some("".into()) };
        assert!(Tokens::load(&empty, Some(String::new())).unwrap().is_none());
    }

    #[test]
    fn every_line_of_the_file_opens_and_nothing_else_does() {
        let folder = tempfile::tempdir().unwrap();
        let option = file(folder.path(), &format!("# new\n{TOKEN}new\n\n  {TOKEN}\n"), 0o640);
        let tokens = Tokens::load(&option, None).unwrap().unwrap();
        for good in [format!("Bearer {TOKEN}"), format!("bearer {TOKEN}new")] {
            assert!(tokens.accepts(Some(good.as_bytes())), "{good}");
        }
        for bad in
            ["", "Bearer ", "Bearer 0123456789abcdef012", "Bearer # new", TOKEN, "Basic 0123456789abcdef0123"]
        {
            assert!(!tokens.accepts(Some(bad.as_bytes())), "{bad}");
        }
        assert!(!tokens.accepts(None));
        assert_eq!(tokens.header().unwrap().as_encoded_bytes(), format!("Bearer {TOKEN}new").as_bytes());
    }

    #[test]
    fn a_token_is_never_shown() {
        let tokens = Tokens::load(&TokenOption::default(), Some(TOKEN.to_owned())).unwrap().unwrap();
        let shown = format!("{tokens:?} {:?} {:?}", Bearer(tokens.header()), tokens.header());
        assert!(!shown.contains(TOKEN), "{shown}");
    }

    #[test]
    fn what_everybody_may_read_is_refused_with_the_remedy() {
        let folder = tempfile::tempdir().unwrap();
        for mode in [0o644, 0o604, 0o602] {
            let error = Tokens::load(&file(folder.path(), TOKEN, mode), None).unwrap_err().to_string();
            assert!(error.contains("--token-file") && error.contains("chmod o-rwx"), "{error}");
            assert!(!error.contains(TOKEN), "{error}");
        }
    }

    #[test]
    fn tokens_that_cannot_serve_are_refused_without_quoting_them() {
        let folder = tempfile::tempdir().unwrap();
        for text in
            ["", "\n# only a comment\n", "short", "with a blank in the middle", "ümläute-ümläute-ümläute"]
        {
            let error = Tokens::load(&file(folder.path(), text, 0o600), None).unwrap_err().to_string();
            assert!(error.contains("token") && (text.len() < 5 || !error.contains(text)), "{error}");
        }
        let option = file(folder.path(), TOKEN, 0o600);
        let error = Tokens::load(&option, Some(TOKEN.to_owned())).unwrap_err();
        assert!(matches!(error, SecurityError::TwoTokens), "{error}");
    }
}
