//! What SUMO need not know.

use std::ffi::OsStr;
use std::process::Command;

/// Endings of names whose variables hold secrets, by common custom.
const SECRET: [&str; 5] = ["TOKEN", "SECRET", "PASSWORD", "PASSPHRASE", "KEY"];

/// Takes those of the given variables that hold secrets, by their names, out of a program's environment. The owner may have
/// been given some; everybody who may read the process's environment could read them there once more.
pub(super) fn hide_secrets<N: AsRef<OsStr>>(command: &mut Command, variables: impl IntoIterator<Item = N>) {
    for name in variables {
        if is_secret(name.as_ref()) {
            command.env_remove(name);
        }
    }
}

/// The last word decides: `API_TOKEN` and `TOKEN` are secrets, `TOKEN_FILE` and `MONKEY` are not.
fn is_secret(name: &OsStr) -> bool {
    let last = name.to_str().and_then(|name| name.rsplit('_').next()).unwrap_or_default();
    SECRET.iter().any(|secret| last.eq_ignore_ascii_case(secret))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_are_told_by_the_last_word_of_their_names() {
        let mut command = Command::new("true");
        let names = [
            "API_TOKEN",
            "token",
            "DB_PASSWORD",
            "AWS_SECRET_ACCESS_KEY",
            "TOKEN_FILE",
            "MONKEY",
            "PATH",
            "",
        ];
        hide_secrets(&mut command, names);
        let mut hidden: Vec<_> =
            command.get_envs().map(|(name, value)| (name.to_str().unwrap(), value)).collect();
        hidden.sort_unstable();
        assert_eq!(
            hidden,
            [("API_TOKEN", None), ("AWS_SECRET_ACCESS_KEY", None), ("DB_PASSWORD", None), ("token", None)]
        );
    }
}
