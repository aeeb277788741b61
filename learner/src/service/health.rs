//! `grpc.health.v1.Health`: in step with the learner's life.
//!
//! The whole server (the empty name) and each of the three services serve exactly while actors may join: not while the model
//! is being set up, and no more once the learner drains.

use crate::coordinator::Life;
use cross_proto::{service as names, status};
use futures::stream::{BoxStream, StreamExt, once, pending};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tonic::{Code, Request, Response, Status};
use tonic_health::ServingStatus;
use tonic_health::pb::health_check_response::ServingStatus as Wire;
use tonic_health::pb::health_server::{Health, HealthServer};
use tonic_health::pb::{HealthCheckRequest, HealthCheckResponse};
use tonic_health::server::{HealthReporter, HealthService};

/// The service, and the task that tells it how the learner is.
pub(super) async fn service(
    life: watch::Receiver<Life>,
    closing: CancellationToken,
) -> (HealthServer<LearnerHealth>, JoinHandle<()>) {
    let reporter = HealthReporter::new();
    // A fresh reporter calls the whole server healthy; it is not, until the model stands.
    report(&reporter, ServingStatus::NotServing).await;
    let reporting = tokio::spawn(follow(reporter.clone(), life));
    let health = LearnerHealth { inner: HealthService::from_health_reporter(reporter), closing };
    (HealthServer::new(health), reporting)
}

async fn follow(health: HealthReporter, mut life: watch::Receiver<Life>) {
    loop {
        let now = *life.borrow_and_update();
        let serving = if now == Life::Serving { ServingStatus::Serving } else { ServingStatus::NotServing };
        report(&health, serving).await;
        if life.changed().await.is_err() {
            return report(&health, ServingStatus::NotServing).await;
        }
    }
}

async fn report(health: &HealthReporter, serving: ServingStatus) {
    for name in [""].into_iter().chain(names::ALL) {
        health.set_service_status(name, serving).await;
    }
}

/// tonic's service, and what it lacks: an error with a reason, and the protocol's answer to who watches an unknown service.
#[derive(Debug)]
pub(super) struct LearnerHealth {
    inner: HealthService,
    closing: CancellationToken,
}

#[tonic::async_trait]
impl Health for LearnerHealth {
    type WatchStream = BoxStream<'static, Result<HealthCheckResponse, Status>>;

    async fn check(
        &self,
        request: Request<HealthCheckRequest>,
    ) -> Result<Response<HealthCheckResponse>, Status> {
        let service = request.get_ref().service.clone();
        self.inner.check(request).await.map_err(|error| match error.code() {
            Code::NotFound => status::unknown_service(&service),
            _ => error,
        })
    }

    async fn watch(
        &self,
        request: Request<HealthCheckRequest>,
    ) -> Result<Response<Self::WatchStream>, Status> {
        match self.inner.watch(request).await {
            Ok(response) => Ok(response.map(StreamExt::boxed)),
            // The protocol wants no error here but an open stream, since a service may come later. None does here.
            Err(error) if error.code() == Code::NotFound => {
                let unknown = HealthCheckResponse { status: Wire::ServiceUnknown.into() };
                let closing = self.closing.clone().cancelled_owned();
                let stream = once(std::future::ready(Ok(unknown))).chain(pending().take_until(closing));
                Ok(Response::new(stream.boxed()))
            }
            Err(error) => Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cross_proto::status::Reason;

    fn request(service: &str) -> Request<HealthCheckRequest> {
        Request::new(HealthCheckRequest { service: service.to_owned() })
    }

    #[tokio::test]
    async fn every_name_serves_exactly_while_actors_may_join() {
        let (life, receiver) = watch::channel(Life::Starting);
        let reporter = HealthReporter::new();
        report(&reporter, ServingStatus::NotServing).await;
        let health = LearnerHealth {
            inner: HealthService::from_health_reporter(reporter.clone()),
            closing: CancellationToken::new(),
        };
        let mut watches = Vec::new();
        for name in ["", "cross.v1.Learner", "cross.v1.Checkpoints", "cross.v1.Training"] {
            let checked = health.check(request(name)).await.unwrap().into_inner().status();
            assert_eq!(checked, Wire::NotServing, "{name} before the start");
            let mut watch = health.watch(request(name)).await.unwrap().into_inner();
            assert_eq!(watch.next().await.unwrap().unwrap().status(), Wire::NotServing, "{name}");
            watches.push((name, watch));
        }
        let following = tokio::spawn(follow(reporter, receiver));
        for (now, expected) in [(Life::Serving, Wire::Serving), (Life::Draining, Wire::NotServing)] {
            life.send_replace(now);
            for (name, watch) in &mut watches {
                // A status that is told again is not news, but allowed.
                while watch.next().await.unwrap().unwrap().status() != expected {}
                let checked = health.check(request(name)).await.unwrap().into_inner().status();
                assert_eq!(checked, expected, "{name} in {now:?}");
            }
        }
        drop(life);
        following.await.unwrap();
    }

    #[tokio::test]
    async fn an_unknown_service_is_named_and_its_watch_stays_open() {
        let (_life, receiver) = watch::channel(Life::Serving);
        let closing = CancellationToken::new();
        let reporter = HealthReporter::new();
        let following = tokio::spawn(follow(reporter.clone(), receiver));
        let health =
            LearnerHealth { inner: HealthService::from_health_reporter(reporter), closing: closing.clone() };
        let error = health.check(request("cross.v1.Trainings")).await.unwrap_err();
        assert_eq!((status::reason(&error), error.code()), (Some(Reason::UnknownService), Code::NotFound));
        assert!(error.message().contains("\"cross.v1.Trainings\""), "{error}");
        assert!(error.message().ends_with("cross.v1.Checkpoints, cross.v1.Training"), "{error}");
        let mut watch = health.watch(request("cross.v1.Trainings")).await.unwrap().into_inner();
        assert_eq!(watch.next().await.unwrap().unwrap().status(), Wire::ServiceUnknown);
        assert!(futures::poll!(watch.next()).is_pending());
        closing.cancel();
        assert!(watch.next().await.is_none());
        following.abort();
    }
}
