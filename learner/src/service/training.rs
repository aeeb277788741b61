//! `cross.v1.Training`: how training goes, and the few things one may ask of it.

use super::Shared;
use crate::coordinator::Request as Ask;
use cross_proto::status::{self, Reason};
use cross_proto::v1::{self, TrainingStatus, training_status::Phase};
use futures::stream::{BoxStream, StreamExt, unfold};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;
use tonic::{Request, Response, Status};

#[derive(Debug)]
pub(super) struct TrainingService {
    shared: Shared,
}

impl TrainingService {
    pub(super) fn new(shared: Shared) -> Self {
        Self { shared }
    }
}

/// The status now, then after every update and whenever training is paused, resumed or ends.
fn progress(
    status: watch::Receiver<TrainingStatus>,
    closing: CancellationToken,
) -> BoxStream<'static, Result<v1::WatchProgressResponse, Status>> {
    let state = (status, None::<(u64, Phase)>, closing);
    unfold(state, |(mut status, seen, closing)| async move {
        loop {
            let now = status.borrow_and_update().clone();
            // Collecting and updating take turns within every update: only their sum is news.
            let phase = if now.phase() == Phase::Updating { Phase::Collecting } else { now.phase() };
            let key = Some((now.updates, phase));
            if key != seen {
                return Some((Ok(v1::WatchProgressResponse { status: Some(now) }), (status, key, closing)));
            }
            tokio::select! {
                // The last status comes before the end: it is what tells that training is complete.
                biased;
                changed = status.changed() => changed.ok()?,
                () = closing.cancelled() => return None,
            }
        }
    })
    .boxed()
}

#[tonic::async_trait]
impl cross_proto::server::Training for TrainingService {
    type WatchProgressStream = BoxStream<'static, Result<v1::WatchProgressResponse, Status>>;

    async fn get_status(
        &self,
        _: Request<v1::GetStatusRequest>,
    ) -> Result<Response<v1::GetStatusResponse>, Status> {
        let status = self.shared.status.borrow().clone();
        Ok(Response::new(v1::GetStatusResponse { status: Some(status) }))
    }

    async fn watch_progress(
        &self,
        _: Request<v1::WatchProgressRequest>,
    ) -> Result<Response<Self::WatchProgressStream>, Status> {
        Ok(Response::new(progress(self.shared.status.clone(), self.shared.closing.clone())))
    }

    async fn pause(&self, _: Request<v1::PauseRequest>) -> Result<Response<v1::PauseResponse>, Status> {
        self.shared.serving().await?;
        self.shared.coordinator.ask(Ask::Pause).await?;
        tracing::info!("paused");
        Ok(Response::new(v1::PauseResponse {}))
    }

    async fn resume(&self, _: Request<v1::ResumeRequest>) -> Result<Response<v1::ResumeResponse>, Status> {
        self.shared.serving().await?;
        self.shared.coordinator.ask(Ask::Resume).await?;
        tracing::info!("resumed");
        Ok(Response::new(v1::ResumeResponse {}))
    }

    async fn checkpoint_now(
        &self,
        _: Request<v1::CheckpointNowRequest>,
    ) -> Result<Response<v1::CheckpointNowResponse>, Status> {
        self.shared.serving().await?;
        match self.shared.coordinator.ask(Ask::Checkpoint).await? {
            Ok(id) => Ok(Response::new(v1::CheckpointNowResponse { id })),
            Err(problem) => Err(status::error(Reason::CheckpointUnusable, problem)),
        }
    }
}
