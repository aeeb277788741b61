//! Objects under a URL: get, put, delete, list, each with a deadline.

use super::trouble::StoreTrouble;
use crate::checkpoint::CheckpointError;
use futures::{FutureExt, TryStreamExt};
use object_store::aws::AmazonS3Builder;
use object_store::azure::MicrosoftAzureBuilder;
use object_store::gcp::GoogleCloudStorageBuilder;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{BackoffConfig, ClientOptions, ObjectStore, ObjectStoreExt, PutMode, RetryConfig};
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;

/// Longest that one request may take, its body included.
const REQUEST: Duration = Duration::from_secs(30);
/// Longest until somebody answers at all.
const CONNECT: Duration = Duration::from_secs(5);
/// Tries of a request after the first; none begins once [`RETRY_UNTIL`] has passed.
const RETRIES: usize = 3;
const RETRY_UNTIL: Duration = Duration::from_secs(10);
/// Longest that an operation may take with everything that the client does for it, such as finding credentials.
const OPERATION: Duration = Duration::from_secs(60);

/// The objects under one URL.
#[derive(Clone)]
pub(super) struct Client {
    store: Arc<dyn ObjectStore>,
    prefix: Path,
    url: String,
    credentials: &'static str,
}

/// Only the URL: the store knows credentials.
impl std::fmt::Debug for Client {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Client").field("url", &self.url).finish_non_exhaustive()
    }
}

/// An object under the URL.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Object {
    /// Its name, from the URL on.
    pub(super) name: String,
    /// Its size, bytes.
    pub(super) bytes: u64,
}

impl Client {
    /// Nothing is asked of the store yet.
    pub(super) fn open(url: &str) -> Result<Self, CheckpointError> {
        let url = url.trim_end_matches('/');
        let unusable = |reason: String| failed("use", url, StoreTrouble::Unusable(reason));
        cross_config::checkpoint_url(url).map_err(|reason| {
            // Of a URL that is refused nothing is repeated: it may hold a password.
            failed("use", "the URL for checkpoints", StoreTrouble::Unusable(format!("it {reason}")))
        })?;
        let (scheme, place) = url.split_once("://").unwrap_or_default();
        if scheme == "file" {
            // Of the whole disk, so that the folder need not be there: the first write makes it, and who only reads a
            // mistyped one makes none.
            let prefix = Path::from_absolute_path(place)
                .map_err(|error| unusable(format!("the folder cannot be used ({error})")))?;
            // A checkpoint that is said to be there is there after a loss of power.
            let store = LocalFileSystem::new().with_fsync(true);
            return Ok(Self { store: Arc::new(store), prefix, url: url.to_owned(), credentials: "" });
        }
        let (bucket, prefix) = place.split_once('/').unwrap_or((place, ""));
        let prefix =
            Path::parse(prefix).map_err(|error| unusable(format!("its path cannot be used ({error})")))?;
        super::environment::check(scheme).map_err(unusable)?;
        // The client takes the process's TLS library as it finds it. One that is set already serves as well.
        let _ = tokio_rustls::rustls::crypto::ring::default_provider().install_default();
        let retry = RetryConfig {
            backoff: BackoffConfig {
                init_backoff: Duration::from_millis(200),
                max_backoff: Duration::from_secs(3),
                base: 2.0,
            },
            max_retries: RETRIES,
            retry_timeout: RETRY_UNTIL,
        };
        let built = match scheme {
            "s3" => build_s3(bucket, retry),
            "gs" => GoogleCloudStorageBuilder::from_env()
                .with_bucket_name(bucket)
                .with_retry(retry)
                .with_client_options(patience())
                .build()
                .map(|store| Arc::new(store) as Arc<dyn ObjectStore>),
            _ => MicrosoftAzureBuilder::from_env()
                .with_container_name(bucket)
                .with_retry(retry)
                .with_client_options(patience())
                .build()
                .map(|store| Arc::new(store) as Arc<dyn ObjectStore>),
        };
        let credentials = match scheme {
            "s3" => "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY",
            "gs" => "GOOGLE_APPLICATION_CREDENTIALS",
            _ => "AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY",
        };
        let store = built.map_err(|error| unusable(unbuilt(&error, credentials)))?;
        Ok(Self { store, prefix, url: url.to_owned(), credentials })
    }

    /// The URL, without a slash at its end.
    pub(super) fn url(&self) -> &str {
        &self.url
    }

    /// The URL of an object.
    pub(super) fn url_of(&self, name: &str) -> String {
        format!("{}/{name}", self.url)
    }

    /// An object's bytes; `None` if there is no such object.
    pub(super) async fn get(&self, name: &str) -> Result<Option<Vec<u8>>, CheckpointError> {
        let path = self.path(name);
        let got = self.within(async { self.store.get(&path).await?.bytes().await }).await;
        match got {
            Ok(bytes) => Ok(Some(bytes.to_vec())),
            Err(Problem::Store(error)) if is_absent(&error) => Ok(None),
            Err(problem) => Err(self.failed("read", name, &problem)),
        }
    }

    /// Writes an object, in one step.
    pub(super) async fn put(&self, name: &str, bytes: Vec<u8>) -> Result<(), CheckpointError> {
        let path = self.path(name);
        let put = self.within(async { self.store.put(&path, bytes.into()).await }).await;
        put.map(|_| ()).map_err(|problem| self.failed("write", name, &problem))
    }

    /// Writes an object that must not be there yet; whether it was not. A store that knows no conditions writes in any case.
    pub(super) async fn create(&self, name: &str, bytes: Vec<u8>) -> Result<bool, CheckpointError> {
        let (path, copy) = (self.path(name), bytes.clone());
        let create = async { self.store.put_opts(&path, copy.into(), PutMode::Create.into()).await };
        match self.within(create).await {
            Ok(_) => Ok(true),
            Err(Problem::Store(object_store::Error::AlreadyExists { .. })) => Ok(false),
            Err(Problem::Store(error)) if knows_no_conditions(&error) => {
                self.put(name, bytes).await.map(|()| true)
            }
            Err(problem) => Err(self.failed("write", name, &problem)),
        }
    }

    /// Copies an object within the store, over one that is there.
    pub(super) async fn copy(&self, from: &str, to: &str) -> Result<(), CheckpointError> {
        let paths = (self.path(from), self.path(to));
        let copied = self.within(async { self.store.copy(&paths.0, &paths.1).await }).await;
        copied.map_err(|problem| self.failed("write", to, &problem))
    }

    /// A store in memory that takes so long to remove anything.
    #[cfg(test)]
    pub(super) fn slow_to_remove(time: Duration) -> Self {
        use object_store::throttle::{ThrottleConfig, ThrottledStore};
        let slow = ThrottleConfig { wait_delete_per_call: time, ..ThrottleConfig::default() };
        let store = ThrottledStore::new(object_store::memory::InMemory::new(), slow);
        Self { store: Arc::new(store), prefix: Path::default(), url: "memory:".to_owned(), credentials: "" }
    }

    /// Removes an object; one that is not there is removed already.
    pub(super) async fn delete(&self, name: &str) -> Result<(), CheckpointError> {
        let path = self.path(name);
        match self.within(async { self.store.delete(&path).await }).await {
            Ok(()) => Ok(()),
            Err(Problem::Store(error)) if is_absent(&error) => Ok(()),
            Err(problem) => Err(self.failed("remove", name, &problem)),
        }
    }

    /// Every object below `folder`.
    pub(super) async fn list(&self, folder: &str) -> Result<Vec<Object>, CheckpointError> {
        let path = self.path(folder);
        let objects: Vec<_> = self
            .within(async { self.store.list(Some(&path)).try_collect().await })
            .await
            .map_err(|problem| self.failed("list", folder, &problem))?;
        let named = |object: object_store::ObjectMeta| {
            let parts: Vec<_> =
                object.location.prefix_match(&self.prefix)?.map(|p| p.as_ref().to_owned()).collect();
            Some(Object { name: parts.join("/"), bytes: object.size })
        };
        Ok(objects.into_iter().filter_map(named).collect())
    }

    fn path(&self, name: &str) -> Path {
        name.split('/')
            .filter(|part| !part.is_empty())
            .fold(self.prefix.clone(), |path, part| path.join(part))
    }

    async fn within<T>(
        &self,
        operation: impl Future<Output = object_store::Result<T>>,
    ) -> Result<T, Problem> {
        // A panic of the client is a defect of it, or a value that environment.rs does not know; it must cost this operation
        // and not the copies of a whole run.
        let guarded = AssertUnwindSafe(operation).catch_unwind();
        match tokio::time::timeout(OPERATION, guarded).await {
            Ok(Ok(Ok(value))) => Ok(value),
            Ok(Ok(Err(error))) => Err(Problem::Store(error)),
            Ok(Err(_)) => Err(Problem::Panic),
            Err(_) => Err(Problem::Slow),
        }
    }

    fn failed(&self, action: &'static str, name: &str, problem: &Problem) -> CheckpointError {
        let trouble = match problem {
            Problem::Store(error) => StoreTrouble::of(error, self.credentials),
            Problem::Panic => {
                StoreTrouble::Other("nothing, because its client failed; its words are in the log".to_owned())
            }
            Problem::Slow => StoreTrouble::Unreachable(format!("no answer within {} s", OPERATION.as_secs())),
        };
        failed(action, &self.url_of(name), trouble)
    }
}

/// Why no client could be made. Its own words may repeat the value of a variable, which may be a secret.
fn unbuilt(error: &object_store::Error, credentials: &str) -> String {
    if super::trouble::chain(error).iter().any(|words| words.contains("CA certificates")) {
        return "there are no certificates of authorities on this machine; install the package ca-certificates, or name \
                a file of them with SSL_CERT_FILE"
            .to_owned();
    }
    format!(
        "a variable of the environment for it is missing or makes no sense ({credentials}, and others of their kind)"
    )
}

enum Problem {
    Store(object_store::Error),
    Panic,
    Slow,
}

fn failed(action: &'static str, url: &str, trouble: StoreTrouble) -> CheckpointError {
    CheckpointError::Store { action, url: url.to_owned(), trouble }
}

/// A missing bucket is answered like a missing object, and is not one.
fn is_absent(error: &object_store::Error) -> bool {
    matches!(error, object_store::Error::NotFound { .. })
        && StoreTrouble::of(error, "") != StoreTrouble::NoBucket
}

/// The client was told so, or the store answers that it has not implemented them.
fn knows_no_conditions(error: &object_store::Error) -> bool {
    matches!(error, object_store::Error::NotImplemented { .. })
        || super::trouble::chain(error).iter().any(|words| words.contains("status code: 501"))
}

fn patience() -> ClientOptions {
    ClientOptions::new().with_connect_timeout(CONNECT).with_timeout(REQUEST)
}

fn build_s3(bucket: &str, retry: RetryConfig) -> object_store::Result<Arc<dyn ObjectStore>> {
    // Replaces what the environment said of the client, hence once more.
    let plain = std::env::var("AWS_ALLOW_HTTP").is_ok_and(|value| matches!(value.as_str(), "true" | "1"));
    let store = AmazonS3Builder::from_env()
        .with_bucket_name(bucket)
        .with_retry(retry)
        .with_client_options(patience().with_allow_http(plain))
        .build()?;
    Ok(Arc::new(store))
}
