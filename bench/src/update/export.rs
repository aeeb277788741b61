//! One epoch's minibatches, padded, in a file, so that another program can learn from the same numbers.

use super::{STEPS, config, data, name};
use crate::error::BenchError;
use crate::plain::{PaddedInputs, PaddedMinibatch};
use crate::progress::Progress;
use cross_config::Gfe;
use cross_model::features::{FeatureSizes, NetworkSpec};
use cross_model::losses;
use cross_model::net::{Net, Role};
use cross_model::rounds::{Networks, Round};
use cross_model::snapshot::{self, Metadata};
use cross_model::value_scale::ValueScales;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::sync::Arc;
use tch::{Kind, Tensor};

/// What the file calls itself.
const FORMAT: &str = "cross-bench-update";

/// Writes `FORM.safetensors` into a folder: the weights that an update starts from (`weight/NAME`), and every minibatch of
/// its first epoch (`NUMBER/NAME`, shapes as in [`PaddedMinibatch`]), with both losses of the first one.
///
/// # Errors
/// [`BenchError`] if the data cannot be made or the file not be written.
pub fn export(form: Gfe, directory: &Path, progress: Progress<'_>) -> Result<(), BenchError> {
    let config = config(form, 6)?;
    let (model, ppo) = (&config.model, &config.ppo);
    let layouts = data::layouts(&config.env, &|line| progress(line));
    let fragments = data::episodes(&layouts, &config, STEPS, 1);
    let sizes = FeatureSizes::new(&config.env, model);
    let mut networks = Networks::new();
    for (name, layout) in &layouts {
        networks.push((name.clone(), Arc::new(NetworkSpec::new(layout, &config.env, model)?)));
    }
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let actor = Net::new(Role::Actor, model, &sizes, &mut rng);
    let critic = Net::new(Role::Critic, model, &sizes, &mut rng);
    let nets = (&actor, &critic);
    let scales = &mut ValueScales::default();
    let round = Round::new(&fragments, &networks, nets, &sizes, model.hidden, ppo, scales)?;

    let mut tensors: Vec<(String, Tensor)> = Vec::new();
    for (name, tensor) in actor.params().iter().chain(critic.params().iter()) {
        tensors.push((format!("weight/{name}"), tensor.detach()));
    }
    let minibatches = round.minibatches(ppo, &mut rng);
    for (number, slices) in minibatches.iter().enumerate() {
        let packed = round.minibatch(slices, &sizes, losses::target_width(model, &sizes));
        let (batch, targets) = (&packed.batch, &packed.targets);
        if number == 0 {
            let (actors, critics) = tch::no_grad(|| {
                let forward = actor.forward(batch, &packed.actor_state);
                let loss = losses::actor(&actor, &forward, batch, targets, model, ppo, ppo.entropy).0;
                let forward = critic.forward(batch, &packed.critic_state);
                (loss.total(), losses::critic(&critic, &forward, batch, targets, model, ppo).total())
            });
            tensors.extend([("0/actor_loss".to_owned(), actors), ("0/critic_loss".to_owned(), critics)]);
        }
        let padded = PaddedMinibatch::new(&packed, &config.env);
        tensors.extend(named(padded).into_iter().map(|(name, tensor)| (format!("{number}/{name}"), tensor)));
    }
    let metadata = Metadata::from([
        ("format".to_owned(), FORMAT.to_owned()),
        ("config".to_owned(), config.to_json()),
        ("minibatches".to_owned(), minibatches.len().to_string()),
        ("decisions".to_owned(), round.decisions().to_string()),
    ]);
    let bytes = snapshot::write(tensors.iter().map(|(name, tensor)| (name.clone(), tensor)), &metadata)?;
    let path = directory.join(format!("{}.safetensors", name(form)));
    let written = std::fs::create_dir_all(directory).and_then(|()| std::fs::write(&path, bytes));
    written.map_err(|source| BenchError::Write { path: path.clone(), source })?;
    progress(&format!("wrote {} minibatches to {}", minibatches.len(), path.display()));
    Ok(())
}

fn named(batch: PaddedMinibatch) -> Vec<(&'static str, Tensor)> {
    let float = |mask: &Tensor| mask.to_kind(Kind::Float);
    let mut out = vec![
        ("phase_mask", float(&batch.phase_mask)),
        ("topology", batch.topology),
        ("actions", float(&batch.actions)),
        ("log_probs", batch.log_probs),
        ("advantages", batch.advantages),
        ("returns", batch.returns),
        ("next", batch.next),
        ("has_next", batch.has_next),
        ("actor_state", batch.actor_state),
        ("critic_state", batch.critic_state),
    ];
    match batch.inputs {
        PaddedInputs::Paper { states, greens, real } => {
            out.extend([("states", states), ("greens", greens), ("real", real)]);
        }
        PaddedInputs::Movement { phases, context, lanes, lane_mask } => {
            let lane_mask = float(&lane_mask);
            out.extend([
                ("phases", phases),
                ("context", context),
                ("lanes", lanes),
                ("lane_mask", lane_mask),
            ]);
        }
    }
    out
}
