//! What is wrong with one field of a message.

/// A field that breaks a rule, named by its path in the message (`fragment.rewards`).
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field} {description}")]
pub struct Violation {
    /// Path of the field, as in the `.proto` file.
    pub field: String,
    /// What is wrong with it, to be read after the field's name.
    pub description: String,
}

impl Violation {
    /// A violation of `field`; `description` continues a sentence that starts with the field.
    pub fn new(field: impl Into<String>, description: impl Into<String>) -> Self {
        Self { field: field.into(), description: description.into() }
    }
}
