//! A port that nobody else is given while SUMO starts.

use std::io;

/// A free TCP port of this machine.
///
/// On Linux it stays taken until dropped, so that two starts at the same moment get different ports and no outgoing
/// connection lands on it. SUMO can listen on it all the same: both sides set `SO_REUSEADDR`, and only one of them
/// listens. Elsewhere the port is merely found free; what happens to it before SUMO listens is what the retry is for.
#[derive(Debug)]
pub(crate) struct PortReservation {
    port: u16,
    #[cfg(target_os = "linux")]
    _held: Option<rustix::fd::OwnedFd>,
}

impl PortReservation {
    /// Lets the system choose a free port.
    #[cfg(target_os = "linux")]
    pub(crate) fn new() -> io::Result<Self> {
        use rustix::net::{AddressFamily, SocketFlags, SocketType, bind, getsockname, socket_with, sockopt};
        use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
        let socket = socket_with(AddressFamily::INET, SocketType::STREAM, SocketFlags::CLOEXEC, None)?;
        sockopt::set_socket_reuseaddr(&socket, true)?;
        // SUMO listens on every address, so the port must be free on every address.
        bind(&socket, &SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, 0))?;
        let address = SocketAddr::try_from(getsockname(&socket)?)?;
        Ok(Self { port: address.port(), _held: Some(socket) })
    }

    /// Lets the system choose a free port.
    #[cfg(not(target_os = "linux"))]
    pub(crate) fn new() -> io::Result<Self> {
        let listener = std::net::TcpListener::bind((std::net::Ipv4Addr::UNSPECIFIED, 0))?;
        Ok(Self { port: listener.local_addr()?.port() })
    }

    /// A port that is not reserved at all, as if somebody had taken it in between.
    #[cfg(test)]
    pub(crate) fn of(port: u16) -> Self {
        Self {
            port,
            #[cfg(target_os = "linux")]
            _held: None,
        }
    }

    /// The port.
    pub(crate) fn port(&self) -> u16 {
        self.port
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[cfg(target_os = "linux")]
    #[test]
    fn reservations_held_together_are_all_different() {
        let held: Vec<_> = (0..200).map(|_| PortReservation::new().unwrap()).collect();
        let ports: HashSet<u16> = held.iter().map(PortReservation::port).collect();
        assert_eq!(ports.len(), held.len());
        assert!(!ports.contains(&0));
    }
}
