//! Going ahead of the answers: messages that are posted, sent together, and answered in their order.

use crate::batch::Replies;
use crate::client::Client;
use crate::error::TraciError;

impl Client {
    /// As [`simulation_step`](Self::simulation_step), but waits for nothing: the step is made when SUMO comes to it, after
    /// all that was posted before. Its answer is [taken](Self::take), or checked and forgotten by the next call that waits.
    ///
    /// # Errors
    /// [`TraciError::Refused`] for a time that is no number, [`TraciError::Unusable`] after an earlier failure.
    pub fn post_step(&mut self, to: f64) -> Result<(), TraciError> {
        self.begin_step(to)?;
        self.post()
    }

    /// Sends what is posted. SUMO begins with it while the caller does something else.
    ///
    /// # Errors
    /// As [`take`](Self::take), but for refusals.
    pub fn flush(&mut self) -> Result<(), TraciError> {
        self.send()
    }

    /// Messages that are posted and whose answers were not taken.
    pub fn waiting(&self) -> usize {
        self.unanswered()
    }

    /// Waits for the answer to the oldest message that is posted and not answered; for nothing if there is none.
    ///
    /// # Errors
    /// [`TraciError::Refused`] names the first refused command of that message; other errors end the connection.
    pub fn take(&mut self) -> Result<Replies<'_>, TraciError> {
        self.send()?;
        if self.unanswered() == 0 {
            self.begin();
        } else {
            self.receive()?;
        }
        Ok(self.replies())
    }
}
