//! `cross.v1.Checkpoints`: what is on the disk, for people and programs.

use super::{COME_AGAIN, Shared};
use crate::checkpoint::{CheckpointError, MODEL_FILE, Metadata, reader, updates_of};
use bytes::Bytes;
use cross_proto::status::{self, Reason};
use cross_proto::weights::CHUNK_BYTES;
use cross_proto::{Violation, v1};
use futures::stream::{BoxStream, StreamExt, iter};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use tokio_util::sync::CancellationToken;
use tonic::{Request, Response, Status};

const DEFAULT_PAGE: usize = 50;
const LARGEST_PAGE: usize = 1000;

#[derive(Debug)]
pub(super) struct CheckpointsService {
    shared: Shared,
}

impl CheckpointsService {
    pub(super) fn new(shared: Shared) -> Self {
        Self { shared }
    }

    /// Runs disk work where it may block.
    async fn on_disk<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Path) -> Result<T, Status> + Send + 'static,
    ) -> Result<T, Status> {
        let run: PathBuf = self.shared.run.clone();
        match tokio::task::spawn_blocking(move || work(&run)).await {
            Ok(result) => result,
            Err(error) => {
                Err(status::error(Reason::Internal, format!("reading checkpoints failed: {error}")))
            }
        }
    }
}

fn failed(id: &str) -> impl Fn(CheckpointError) -> Status {
    move |error| match error {
        CheckpointError::NotFound { .. } => status::checkpoint_not_found(id),
        error => status::error(Reason::CheckpointUnusable, error.to_string()),
    }
}

fn message(metadata: &Metadata) -> v1::Checkpoint {
    v1::Checkpoint {
        id: metadata.id.clone(),
        created: Some(metadata.created_at().into()),
        format_version: metadata.format_version,
        run_id: metadata.run_id.clone(),
        updates: metadata.updates,
        policy_version: metadata.policy_version,
        decisions: metadata.decisions,
        episodes: metadata.episodes,
        seed: metadata.seed,
        config_hash: metadata.config_hash.clone(),
        config_json: metadata.config.to_string(),
        versions: Some(v1::checkpoint::Versions {
            cross: metadata.versions.cross.clone(),
            sumo: metadata.versions.sumo.clone(),
            libtorch: metadata.versions.libtorch.clone(),
        }),
        model_bytes: metadata.files.get(MODEL_FILE).map_or(0, |file| file.bytes),
        episode_return: metadata.episode_return.clone(),
    }
}

#[tonic::async_trait]
impl cross_proto::server::Checkpoints for CheckpointsService {
    type DownloadCheckpointStream = BoxStream<'static, Result<v1::DownloadCheckpointResponse, Status>>;

    async fn list_checkpoints(
        &self,
        request: Request<v1::ListCheckpointsRequest>,
    ) -> Result<Response<v1::ListCheckpointsResponse>, Status> {
        let request = request.into_inner();
        let size = match request.page_size as usize {
            0 => DEFAULT_PAGE,
            size => size.min(LARGEST_PAGE),
        };
        // The token is the last id of the page before, so that checkpoints written meanwhile shift nothing.
        let after = match request.page_token.as_str() {
            "" => None,
            token => Some(updates_of(token).ok_or_else(|| {
                status::invalid(&Violation::new("page_token", "is not one that ListCheckpoints gave"))
            })?),
        };
        let entries = self.on_disk(|run| reader::list(run).map_err(failed("")));
        let mut page: Vec<v1::Checkpoint> = Vec::new();
        let mut next_page_token = String::new();
        for entry in entries.await? {
            if after.is_some_and(|after| updates_of(&entry.id) >= Some(after)) {
                continue;
            }
            match entry.metadata {
                Ok(_) if page.len() == size => {
                    next_page_token = page.last().map(|last| last.id.clone()).unwrap_or_default();
                    break;
                }
                Ok(metadata) => page.push(message(&metadata)),
                Err(error) => tracing::warn!("left out of the list: {error}"),
            }
        }
        Ok(Response::new(v1::ListCheckpointsResponse { checkpoints: page, next_page_token }))
    }

    async fn get_checkpoint(
        &self,
        request: Request<v1::GetCheckpointRequest>,
    ) -> Result<Response<v1::GetCheckpointResponse>, Status> {
        let id = request.into_inner().id;
        let response = self.on_disk(move |run| {
            let path = reader::find(run, &id).map_err(failed(&id))?;
            let metadata = reader::metadata(&path).map_err(failed(&id))?;
            let tensors = reader::tensors(&path).map_err(failed(&id))?;
            let info = |tensor: reader::Tensor| v1::TensorInfo {
                name: tensor.name,
                dtype: tensor.dtype,
                shape: tensor.shape.into_iter().map(|dimension| dimension as u64).collect(),
            };
            Ok(v1::GetCheckpointResponse {
                checkpoint: Some(message(&metadata)),
                tensors: tensors.into_iter().map(info).collect(),
            })
        });
        Ok(Response::new(response.await?))
    }

    async fn download_checkpoint(
        &self,
        request: Request<v1::DownloadCheckpointRequest>,
    ) -> Result<Response<Self::DownloadCheckpointStream>, Status> {
        let id = request.into_inner().id;
        let file = self.on_disk(move |run| {
            let path = reader::find(run, &id).map_err(failed(&id))?;
            let (_, bytes) = reader::model(&path).map_err(failed(&id))?;
            let sha256 = Sha256::digest(&bytes).to_vec();
            Ok((Bytes::from(bytes), Bytes::from(sha256)))
        });
        let (bytes, sha256) = file.await?;
        Ok(Response::new(iter(chunks(bytes, sha256, self.shared.closing.clone())).boxed()))
    }
}

/// A file in pieces. Once the learner is `closing` the next one is an error: an end would look like the end of the file.
fn chunks(
    bytes: Bytes,
    sha256: Bytes,
    closing: CancellationToken,
) -> impl Iterator<Item = Result<v1::DownloadCheckpointResponse, Status>> {
    (0..bytes.len()).step_by(CHUNK_BYTES).map(move |start| {
        if closing.is_cancelled() {
            return Err(status::draining(COME_AGAIN));
        }
        let end = bytes.len().min(start + CHUNK_BYTES);
        Ok(v1::DownloadCheckpointResponse {
            offset: start as u64,
            total_bytes: bytes.len() as u64,
            chunk: bytes.slice(start..end),
            sha256: if end == bytes.len() { sha256.clone() } else { Bytes::new() },
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_download_that_the_end_of_the_learner_cuts_off_ends_in_an_error() {
        let closing = CancellationToken::new();
        let file = Bytes::from(vec![7; 2 * CHUNK_BYTES + 1]);
        let mut pieces = chunks(file.clone(), Bytes::from_static(b"sum"), closing.clone());
        let whole: Vec<_> = chunks(file, Bytes::from_static(b"sum"), closing.clone()).flatten().collect();
        assert_eq!(whole.iter().map(|piece| piece.chunk.len()).sum::<usize>(), 2 * CHUNK_BYTES + 1);
        assert_eq!(whole.iter().filter(|piece| !piece.sha256.is_empty()).count(), 1);
        assert_eq!(pieces.next().unwrap().unwrap(), whole[0]);
        closing.cancel();
        let error = pieces.next().unwrap().unwrap_err();
        assert_eq!(status::reason(&error), Some(Reason::Draining));
    }
}
