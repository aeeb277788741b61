//! Copies of checkpoints, through interruptions and damage, in a directory by URL: the same code as for an object store, of
//! which the cluster tests start a real one.

use super::{Named, Remote, named, resume};
use crate::checkpoint::reader::{self, parcel};
use crate::checkpoint::tests::{COMPATIBLE, files, run_with};
use crate::checkpoint::{
    CheckpointError, FOLDER, LATEST_FILE, METADATA_FILE, MODEL_FILE, OPTIMIZER_FILE, Store,
};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

struct Place {
    folder: TempDir,
    remote: Remote,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let remote = Remote::open(&format!("file://{}/a/b", folder.path().display())).unwrap();
        Self { folder, remote }
    }

    /// Copies of a run's checkpoints, oldest first.
    async fn with(run: &Path, updates: &[u64]) -> Self {
        let place = Self::new();
        for updates in updates {
            place.upload(run, *updates).await;
        }
        place
    }

    async fn upload(&self, run: &Path, updates: u64) {
        let path = run.join(FOLDER).join(crate::checkpoint::id(updates));
        self.remote.upload(&parcel(&path).unwrap()).await.unwrap();
    }

    fn file(&self, id: &str, name: &str) -> PathBuf {
        self.folder.path().join("a/b").join(FOLDER).join(id).join(name)
    }

    async fn ids(&self) -> Vec<String> {
        self.remote.ids().await.unwrap()
    }
}

async fn resumed(run: &Path, place: &Place) -> Result<super::Fetched, CheckpointError> {
    resume(run, None, &place.remote, COMPATIBLE).await
}

#[tokio::test]
async fn what_is_copied_reads_back_and_latest_names_it() {
    let run = run_with(&[1, 12]);
    let place = Place::with(run.path(), &[1, 12]).await;
    assert_eq!(place.ids().await, ["000012", "000001"]);
    let id = place.remote.find(LATEST_FILE).await.unwrap();
    assert_eq!(id, "000012");
    let checkpoint = place.remote.read(&id).await.unwrap();
    assert_eq!(checkpoint.files, files(12));
    assert!(checkpoint.path.to_str().unwrap().starts_with("file:///"), "{checkpoint:?}");
    assert_eq!(place.remote.model(&id).await.unwrap().1, files(12).model);
    let listed = place.remote.list().await.unwrap();
    assert_eq!(
        listed.iter().map(|entry| entry.metadata.as_ref().unwrap().updates).collect::<Vec<_>>(),
        [12, 1]
    );
    for wrong in ["000013", "..", "", "1", "../000012"] {
        let error = place.remote.find(wrong).await.unwrap_err();
        assert!(matches!(error, CheckpointError::NotFound { .. }), "{wrong}: {error}");
    }
}

/// The process is killed between any two objects of an upload.
#[tokio::test]
async fn half_a_copy_is_no_checkpoint_at_any_moment() {
    let run = run_with(&[1, 2]);
    let path = run.path().join(FOLDER).join("000002");
    let order = [MODEL_FILE, OPTIMIZER_FILE, METADATA_FILE];
    for sent in 0..order.len() {
        let place = Place::with(run.path(), &[1]).await;
        for name in &order[..sent] {
            place
                .remote
                .client
                .put(&format!("{FOLDER}/000002/{name}"), fs::read(path.join(name)).unwrap())
                .await
                .unwrap();
        }
        assert_eq!(place.ids().await, ["000001"], "after {sent} objects");
        assert_eq!(place.remote.find(LATEST_FILE).await.unwrap(), "000001");
        let empty = tempfile::tempdir().unwrap();
        let found = resumed(empty.path(), &place).await.unwrap();
        assert!(found.damaged.is_empty());
        assert_eq!(found.resumed.unwrap().checkpoint.metadata.updates, 1);
    }
}

/// It is uploaded again after the run went back: there must be no moment in which new files lie under the old description.
#[tokio::test]
async fn a_copy_that_replaces_another_is_never_a_mixture() {
    let run = run_with(&[5]);
    let place = Place::with(run.path(), &[5]).await;
    let mut other = parcel(&run.path().join(FOLDER).join("000005")).unwrap();
    other.description.push(b'\n');
    // A directory in the way of the first file: the upload fails there.
    fs::remove_file(place.file("000005", MODEL_FILE)).unwrap();
    fs::create_dir_all(place.file("000005", MODEL_FILE).join("x")).unwrap();
    assert!(place.remote.upload(&other).await.is_err());
    assert!(place.ids().await.is_empty(), "the old description is gone before the files change");
    fs::remove_dir_all(place.file("000005", MODEL_FILE)).unwrap();
    place.remote.upload(&other).await.unwrap();
    assert_eq!(place.remote.parcel("000005").await.unwrap(), other);
}

#[tokio::test]
async fn a_copy_that_is_there_is_not_sent_again() {
    let run = run_with(&[5]);
    let place = Place::with(run.path(), &[5]).await;
    // Would be restored if it were sent again.
    fs::write(place.file("000005", MODEL_FILE), "touched").unwrap();
    place.upload(run.path(), 5).await;
    assert_eq!(fs::read(place.file("000005", MODEL_FILE)).unwrap(), b"touched");
}

#[tokio::test]
async fn old_copies_are_removed_with_what_interruptions_left_and_the_latest_never() {
    let run = run_with(&[1, 2, 3, 4]);
    let place = Place::with(run.path(), &[1, 2, 3, 4]).await;
    fs::remove_file(place.file("000001", METADATA_FILE)).unwrap();
    place.remote.prune(2, "000004").await.unwrap();
    assert_eq!(place.ids().await, ["000004", "000003"]);
    assert!(!place.file("000001", MODEL_FILE).exists() && !place.file("000002", MODEL_FILE).exists());
    // After going back, the latest is not the one of the highest number; it stays.
    place.remote.prune(1, "000003").await.unwrap();
    assert_eq!(place.ids().await, ["000003"]);
    assert_eq!(place.remote.read("000003").await.unwrap().files, files(3));
}

#[tokio::test]
async fn a_run_goes_on_from_the_newest_of_disk_and_store() {
    let long = run_with(&[1, 2, 3]);
    for (local, stored, expected) in
        [(&[][..], &[1, 2][..], 2), (&[1], &[1, 2, 3], 3), (&[3], &[1, 2], 3), (&[2], &[], 2)]
    {
        let (run, place) = (run_with(local), Place::with(long.path(), stored).await);
        let found = resumed(run.path(), &place).await.unwrap().resumed.unwrap();
        assert_eq!(found.checkpoint.metadata.updates, expected);
        assert!(found.checkpoint.path.starts_with(run.path()), "it is on the disk before it is used");
        assert_eq!(found.checkpoint.files, files(expected as u8));
        Store::open(run.path(), 10).unwrap().go_on_from(&found.checkpoint.metadata.id).unwrap();
        reader::verify(&reader::find(run.path(), LATEST_FILE).unwrap()).unwrap();
    }
    let empty = tempfile::tempdir().unwrap();
    assert!(resumed(empty.path(), &Place::new()).await.unwrap().resumed.is_none());
}

#[tokio::test]
async fn a_damaged_copy_is_passed_over_set_aside_and_named_by_its_url() {
    type Damage = fn(&Path);
    let cases: [(&str, &str, Damage); 4] = [
        (MODEL_FILE, "cut off", |file| fs::write(file, "half").unwrap()),
        (OPTIMIZER_FILE, "has no", |file| fs::remove_file(file).unwrap()),
        (METADATA_FILE, "not valid JSON", |file| fs::write(file, "{").unwrap()),
        (OPTIMIZER_FILE, "SHA-256", |file| {
            let mut bytes = fs::read(file).unwrap();
            *bytes.last_mut().unwrap() ^= 1;
            fs::write(file, bytes).unwrap();
        }),
    ];
    let long = run_with(&[1, 2]);
    for (name, words, damage) in cases {
        let place = Place::with(long.path(), &[1, 2]).await;
        damage(&place.file("000002", name));
        let run = tempfile::tempdir().unwrap();
        let found = resumed(run.path(), &place).await.unwrap();
        assert_eq!(found.damaged, ["000002"]);
        let found = found.resumed.unwrap();
        assert_eq!(found.checkpoint.metadata.updates, 1);
        let text = found.skipped[0].to_string();
        assert!(text.contains("file:///") && text.contains("000002") && text.contains(words), "{text}");
        place.remote.set_aside("000002").await.unwrap();
        assert_eq!(place.ids().await, ["000001"], "nobody trips over it");
        assert!(!place.file("000002", MODEL_FILE).exists() && !place.file("000002", name).exists());
        // A second try, as after an answer that was lost.
        place.remote.set_aside("000002").await.unwrap();
        // The run comes to the same number again, and then far beyond it.
        place.upload(long.path(), 2).await;
        place.remote.prune(1, "000002").await.unwrap();
        assert_eq!(place.ids().await, ["000002"]);
        assert!(place.file("damaged-000002", METADATA_FILE).exists(), "and a person can look");
        place.remote.remove("000002", METADATA_FILE).await.unwrap();
        place.upload(long.path(), 1).await;

        fs::remove_file(place.file("000001", MODEL_FILE)).unwrap();
        let error = resumed(tempfile::tempdir().unwrap().path(), &place).await.unwrap_err();
        assert!(matches!(error, CheckpointError::NoneUsable { count: 1, .. }), "{error}");
    }
}

#[tokio::test]
async fn the_store_has_what_the_disk_has_lost() {
    let run = run_with(&[1, 2]);
    let place = Place::with(run.path(), &[1, 2]).await;
    for id in ["000001", "000002"] {
        fs::write(run.path().join(FOLDER).join(id).join(MODEL_FILE), "half").unwrap();
    }
    let found = resumed(run.path(), &place).await.unwrap().resumed.unwrap();
    assert_eq!((found.checkpoint.metadata.updates, found.skipped.len()), (2, 0));
    reader::verify(&run.path().join(FOLDER).join("000002")).unwrap();
}

#[tokio::test]
async fn a_place_belongs_to_one_run_and_one_configuration() {
    let run = run_with(&[1]);
    let place = Place::new();
    place.remote.refuse_used().await.unwrap();
    place.remote.claim("run").await.unwrap();
    place.remote.claim("run").await.unwrap();
    let other = place.remote.claim("second").await.unwrap_err().to_string();
    assert!(other.contains("run run") && other.contains("second") && other.contains("file:///"), "{other}");
    let found = resumed(tempfile::tempdir().unwrap().path(), &place).await.unwrap();
    assert_eq!(found.owner.as_deref(), Some("run"), "a run without a disk learns who it is");
    let used = place.remote.refuse_used().await.unwrap_err().to_string();
    assert!(used.contains("--resume"), "{used}");
    let error = resume(run.path(), Some("second"), &place.remote, COMPATIBLE).await.unwrap_err();
    assert!(matches!(error, CheckpointError::OtherRun { .. }), "{error}");
    place.upload(run.path(), 1).await;
    let empty = tempfile::tempdir().unwrap();
    let error = resume(empty.path(), Some("run"), &place.remote, "feedfeed").await.unwrap_err();
    assert!(error.to_string().contains("feedfeed") && error.to_string().contains("file:///"), "{error}");
    assert!(!empty.path().join(FOLDER).exists(), "nothing is written of what is refused");
}

#[tokio::test]
async fn of_two_runs_that_claim_a_place_at_a_time_one_gets_it() {
    for _ in 0..20 {
        let place = Place::new();
        let claims = tokio::join!(place.remote.claim("a"), place.remote.claim("b"));
        assert!(claims.0.is_ok() != claims.1.is_ok(), "{claims:?}");
        let (winner, loser) = if claims.0.is_ok() { ("a", "b") } else { ("b", "a") };
        place.remote.claim(winner).await.unwrap();
        let error = place.remote.claim(loser).await.unwrap_err();
        assert!(matches!(error, CheckpointError::OtherRun { .. }), "{error}");
    }
}

#[tokio::test]
async fn checkpoints_without_an_owner_say_themselves_whose_they_are() {
    let run = run_with(&[1, 2]);
    let place = Place::with(run.path(), &[1, 2]).await;
    let error = place.remote.claim("second").await.unwrap_err();
    assert!(matches!(&error, CheckpointError::OtherRun { got, .. } if got == "run"), "{error}");
    // One that cannot be read says nothing.
    fs::write(place.file("000002", METADATA_FILE), "{").unwrap();
    let error = resume(tempfile::tempdir().unwrap().path(), Some("second"), &place.remote, COMPATIBLE).await;
    assert!(matches!(error, Err(CheckpointError::OtherRun { .. })), "{error:?}");
    place.remote.claim("run").await.unwrap();

    let place = Place::with(run.path(), &[1]).await;
    fs::write(place.file("000001", METADATA_FILE), "{").unwrap();
    let error = place.remote.claim("run").await.unwrap_err();
    assert!(matches!(&error, CheckpointError::OtherRun { got, .. } if got == "unknown"), "{error}");
}

#[tokio::test]
async fn a_checkpoint_under_another_s_number_is_damaged() {
    let run = run_with(&[1, 2]);
    let place = Place::with(run.path(), &[1]).await;
    fs::rename(place.file("000001", ""), place.file("000009", "")).unwrap();
    place.upload(run.path(), 2).await;
    let found = resumed(tempfile::tempdir().unwrap().path(), &place).await.unwrap();
    assert_eq!(found.damaged, ["000009"]);
    assert_eq!(found.resumed.unwrap().checkpoint.metadata.updates, 2);
}

#[tokio::test]
async fn a_folder_that_is_only_asked_is_not_made() {
    let folder = tempfile::tempdir().unwrap();
    let typo = format!("{}/\u{fc}%20/typo", folder.path().display());
    let remote = Remote::open(&format!("file://{typo}")).unwrap();
    assert!(remote.list().await.unwrap().is_empty());
    assert!(matches!(remote.find(LATEST_FILE).await, Err(CheckpointError::NotFound { .. })));
    remote.refuse_used().await.unwrap();
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    remote.claim("run").await.unwrap();
    assert!(Path::new(&typo).join("run.json").exists(), "under the name that was given");
}

#[tokio::test]
async fn work_that_panics_is_an_error() {
    let work = || -> Result<(), CheckpointError> { panic!("on purpose") };
    let error = crate::checkpoint::blocking(PathBuf::from("/x/000001"), work).await.unwrap_err();
    assert!(error.to_string().contains("/x/000001"), "{error}");
}

#[test]
fn urls_of_runs_checkpoints_and_files_are_told_apart() {
    for (text, meaning) in [
        ("runs/a", None),
        ("s3://b/a", Some(Named::Run("s3://b/a".to_owned()))),
        ("s3://b/a/", Some(Named::Run("s3://b/a".to_owned()))),
        ("s3://b/checkpoints/000120", Some(Named::Checkpoint("s3://b".to_owned(), "000120".to_owned()))),
        ("s3://b/a/checkpoints/latest", Some(Named::Checkpoint("s3://b/a".to_owned(), "latest".to_owned()))),
        ("s3://b/a/checkpoints/000120/", Some(Named::Checkpoint("s3://b/a".to_owned(), "000120".to_owned()))),
        ("s3://b/000120", Some(Named::Run("s3://b/000120".to_owned()))),
        ("gs://b/x/p.safetensors", Some(Named::File("gs://b/x".to_owned(), "p.safetensors".to_owned()))),
    ] {
        assert_eq!(named(text), meaning, "{text}");
    }
}

#[test]
fn a_url_that_is_refused_is_not_repeated() {
    let error = Remote::open("s3://KEY:hidden@bucket/x").unwrap_err().to_string();
    assert!(error.contains("password") && !error.contains("hidden"), "{error}");
}
