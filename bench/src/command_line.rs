//! SUMO's command line, read from the kernel to be given to another SUMO.

use crate::error::BenchError;
use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::OsStrExt;

/// What only a SUMO with a client needs; each is followed by a value.
pub(crate) const CLIENT: [&str; 2] = ["--remote-port", "--num-clients"];

/// The arguments of a running process, as the kernel has them.
pub(crate) fn of_process(pid: u32) -> Result<Vec<OsString>, BenchError> {
    let path = format!("/proc/{pid}/cmdline");
    let bytes =
        std::fs::read(&path).map_err(|source| BenchError::CommandLine { path: path.into(), source })?;
    Ok(split(&bytes))
}

/// Arguments that each end with a zero byte; the first names the program.
fn split(bytes: &[u8]) -> Vec<OsString> {
    let bytes = bytes.strip_suffix(b"\0").unwrap_or(bytes);
    bytes.split(|&byte| byte == 0).skip(1).map(|part| OsStr::from_bytes(part).to_owned()).collect()
}

/// The same arguments but for these options and the value behind each.
pub(crate) fn without(arguments: &[OsString], options: &[&str]) -> Vec<OsString> {
    let mut left = Vec::with_capacity(arguments.len());
    let mut rest = arguments.iter();
    while let Some(argument) = rest.next() {
        if options.iter().any(|option| argument == option) {
            rest.next();
        } else {
            left.push(argument.clone());
        }
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernels_form_of_a_command_line_is_read() {
        assert_eq!(split(b"/bin/sumo\0-n\0a b.xml\0--x\0\0"), ["-n", "a b.xml", "--x", ""]);
        assert_eq!(split(b""), Vec::<OsString>::new());
    }

    #[test]
    fn options_go_with_their_values() {
        let arguments =
            ["-n", "a", "--remote-port", "7", "--num-clients", "1", "-r", "b"].map(OsString::from);
        assert_eq!(without(&arguments, &CLIENT), ["-n", "a", "-r", "b"]);
        assert_eq!(without(&arguments, &["-r"]).len(), 6);
    }
}
