//! Waiting until the child itself listens on its port.
//!
//! Connecting until it works would also work with a stranger's SUMO on the same port. Linux tells in `/proc` which
//! process a listening socket belongs to.

/// Whether process `pid` listens on TCP `port`; `None` where the system does not tell.
#[cfg(target_os = "linux")]
pub(crate) fn listens(pid: u32, port: u16) -> Option<bool> {
    // Of a process that has just ended nothing can be read: it does not listen. Only where this process cannot look
    // at itself either does the system not tell.
    let unknown = || std::fs::metadata("/proc/self/net/tcp").is_ok().then_some(false);
    let Ok(sockets) = std::fs::read_to_string(format!("/proc/{pid}/net/tcp")) else { return unknown() };
    let Some(inode) = listening_inode(&sockets, port) else { return Some(false) };
    let link = format!("socket:[{inode}]");
    let Ok(files) = std::fs::read_dir(format!("/proc/{pid}/fd")) else { return unknown() };
    Some(
        files.flatten().any(|file| {
            std::fs::read_link(file.path()).is_ok_and(|target| target.as_os_str() == link.as_str())
        }),
    )
}

/// Whether process `pid` listens on TCP `port`; `None` where the system does not tell.
#[cfg(not(target_os = "linux"))]
pub(crate) fn listens(_: u32, _: u16) -> Option<bool> {
    None
}

/// The inode of the socket that listens on `port`, from the table in `/proc/net/tcp`.
#[cfg(target_os = "linux")]
fn listening_inode(table: &str, port: u16) -> Option<&str> {
    const LISTEN: &str = "0A";
    table.lines().skip(1).find_map(|line| {
        let mut fields = line.split_ascii_whitespace();
        let local = fields.nth(1)?;
        let state = fields.nth(1)?;
        let (_, hex) = local.split_once(':')?;
        (state == LISTEN && u16::from_str_radix(hex, 16) == Ok(port)).then(|| fields.nth(5)).flatten()
    })
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use std::net::TcpListener;

    #[test]
    fn only_the_owner_of_a_listening_socket_listens() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        assert_eq!(listens(std::process::id(), port), Some(true));
        assert_ne!(listens(1, port), Some(true));
        drop(listener);
        assert_eq!(listens(std::process::id(), port), Some(false));
    }

    #[test]
    fn a_table_that_is_no_table_holds_nothing() {
        assert_eq!(listening_inode("sl\n0: x\n: : : :\n", 1), None);
        assert_eq!(listening_inode("", 1), None);
    }
}
