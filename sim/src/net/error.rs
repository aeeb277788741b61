//! Errors of reading a net.

use std::path::PathBuf;

/// A net that cannot be used. Every variant names the file.
#[derive(Debug, thiserror::Error)]
pub enum NetError {
    /// The file cannot be opened or read.
    #[error("cannot read the net {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text ends before the net does.
    #[error("the net {} is cut off inside <{element}>; fetch or generate it again", path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Innermost element that is open at the end.
        element: String,
    },
    /// The text is not XML.
    #[error("the net {} is not valid XML near byte {position}: {message}", path.display())]
    Xml {
        /// The file.
        path: PathBuf,
        /// Byte offset into the (decompressed) text.
        position: u64,
        /// The parser's words.
        message: String,
    },
    /// XML, but not a SUMO net.
    #[error("{} is not a SUMO net: its root element is <{root}>, not <net>", path.display())]
    NotANet {
        /// The file.
        path: PathBuf,
        /// The root element; empty for a document without one.
        root: String,
    },
    /// A net that lacks something or contradicts itself.
    #[error("the net {} is unusable: {what}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong, naming the element.
        what: String,
    },
}
