//! Reading a fixture, and putting its rows into the order of a packed batch.

use cross_config::{ComputeDevice, Config, ValueScale};
use cross_model::features::{FeatureSizes, NetworkSpec};
use cross_model::losses;
use cross_model::net::{Net, Role};
use cross_model::rounds::{Minibatch, Networks, Round};
use cross_model::value_scale::ValueScales;
use cross_sim::layout::{Intersection, Lane, Movement, NetworkLayout, Phase, Road};
use cross_sim::trajectory::{Fragment, FragmentEnd, FragmentId, RecurrentState};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use safetensors::SafeTensors;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use tch::Tensor;

/// A fixture's inputs in this project's types, with networks that bear its weights.
pub(crate) struct Fixture {
    pub(crate) config: Config,
    pub(crate) layouts: Vec<(String, Arc<NetworkLayout>)>,
    pub(crate) fragments: Vec<Fragment>,
    pub(crate) tensors: BTreeMap<String, Tensor>,
    pub(crate) actor: Net,
    pub(crate) critic: Net,
    sizes: FeatureSizes,
    networks: Networks,
}

/// One minibatch of all of a fixture's sequences.
pub(crate) struct Learning {
    pub(crate) minibatch: Minibatch,
    steps: i64,
    /// Phases of every sequence in the fixture's order.
    phases: Vec<i64>,
}

#[derive(Deserialize)]
struct Golden {
    config: serde_json::Value,
    layouts: BTreeMap<String, Vec<JunctionJson>>,
    fragments: Vec<FragmentJson>,
}

#[derive(Deserialize)]
struct JunctionJson {
    id: String,
    position: (f32, f32),
    incoming: Vec<LaneJson>,
    outgoing: Vec<LaneJson>,
    movements: Vec<MovementJson>,
    phases: Vec<PhaseJson>,
    roads_in: Vec<RoadJson>,
    roads_out: Vec<RoadJson>,
}

#[derive(Deserialize)]
struct LaneJson {
    id: String,
    length: f32,
    speed: f32,
}

#[derive(Deserialize)]
struct MovementJson {
    incoming: usize,
    outgoing: usize,
}

#[derive(Deserialize)]
struct PhaseJson {
    state: String,
    green: Vec<f32>,
}

#[derive(Deserialize)]
struct RoadJson {
    id: String,
    length: f32,
    speed: f32,
    lanes: usize,
    movements: usize,
}

#[derive(Deserialize)]
struct FragmentJson {
    scenario: String,
    episode: u64,
    sequence: u32,
    first_step: u32,
    steps: u32,
    counts: Vec<u16>,
    phases: Vec<u8>,
    actions: Vec<u8>,
    log_probs: Vec<f32>,
    rewards: Vec<f32>,
    recurrent: RecurrentJson,
    end: EndJson,
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum EndJson {
    Continues,
    Truncated,
    Terminated,
}

#[derive(Deserialize)]
struct RecurrentJson {
    actor: Vec<f32>,
    critic: Vec<f32>,
}

impl Fixture {
    pub(crate) fn load(name: &str) -> Self {
        cross_model::set_single_threaded();
        let path =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(format!("{name}.safetensors"));
        let bytes = std::fs::read(&path).unwrap();
        let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
        let golden: Golden = serde_json::from_str(&header.metadata().as_ref().unwrap()["golden"]).unwrap();
        let mut config = Config::from_json(&golden.config.to_string(), name).unwrap();
        // cuDNN rounds to TensorFloat-32, which these tolerances do not allow.
        config.learner.device = ComputeDevice::Cpu;
        // The reference fits returns as they are.
        config.ppo.value_scale = ValueScale::Raw;
        let tensors = tensors_of(&bytes);
        let sizes = FeatureSizes::new(&config.env, &config.model);
        let layouts: Vec<(String, Arc<NetworkLayout>)> = golden
            .layouts
            .into_iter()
            .map(|(scenario, junctions)| {
                let intersections = junctions.into_iter().map(Intersection::from).collect();
                (scenario, Arc::new(NetworkLayout { intersections }))
            })
            .collect();
        let networks: Networks = layouts
            .iter()
            .map(|(scenario, layout)| {
                let spec = NetworkSpec::new(layout, &config.env, &config.model).unwrap();
                (scenario.clone(), Arc::new(spec))
            })
            .collect();
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let mut net = |role| Net::new(role, &config.model, &sizes, &mut rng);
        let (actor, critic) = (net(Role::Actor), net(Role::Critic));
        let fragments = golden.fragments.into_iter().map(Fragment::from).collect();
        let fixture = Self { config, layouts, fragments, tensors, actor, critic, sizes, networks };
        fixture.set_weights();
        fixture
    }

    /// Every parameter has its tensor of the same shape, and no tensor is left over.
    fn set_weights(&self) {
        let mut names = Vec::new();
        for (name, parameter) in self.actor.params().iter().chain(self.critic.params().iter()) {
            let key = format!("weight/{name}");
            assert_eq!(self.tensors.get(&key).map(Tensor::size), Some(parameter.size()), "{key}");
            tch::no_grad(|| parameter.shallow_clone().copy_(&self.tensors[&key]));
            names.push(key);
        }
        names.sort();
        assert_eq!(names, self.keys("weight/"));
    }

    /// Names of the tensors below a prefix, sorted.
    pub(crate) fn keys(&self, prefix: &str) -> Vec<String> {
        self.tensors.keys().filter(|key| key.starts_with(prefix)).cloned().collect()
    }

    pub(crate) fn network(&self, scenario: &str) -> &NetworkSpec {
        &self.networks.iter().find(|(name, _)| name == scenario).unwrap().1
    }
}

impl Learning {
    pub(crate) fn new(fixture: &Fixture) -> Self {
        let (model, ppo) = (&fixture.config.model, &fixture.config.ppo);
        let nets = (&fixture.actor, &fixture.critic);
        let (fragments, networks, sizes) = (&fixture.fragments, &fixture.networks, &fixture.sizes);
        let scales = &mut ValueScales::default();
        let round = Round::new(fragments, networks, nets, sizes, model.hidden, ppo, scales).unwrap();
        let by_length = round.slices(ppo.sequence_steps as usize);
        assert_eq!(by_length.len(), 1, "the fixture's sequences have one length");
        let (&steps, slices) = by_length.first_key_value().unwrap();
        let target = losses::target_width(model, &fixture.sizes);
        let minibatch = round.minibatch(slices, &fixture.sizes, target);
        let mut phases = Vec::new();
        for fragment in &fixture.fragments {
            for agent in &fixture.network(&fragment.scenario).agents {
                phases.extend((0..fragment.steps as usize).step_by(steps).map(|_| agent.phases as i64));
            }
        }
        assert_eq!(phases.len(), slices.len());
        Self { minibatch, steps: steps as i64, phases }
    }

    pub(crate) fn state(&self, role: Role) -> &Tensor {
        match role {
            Role::Actor => &self.minibatch.actor_state,
            Role::Critic => &self.minibatch.critic_state,
        }
    }

    /// `x` `[sequences, ..]` in packed order.
    pub(crate) fn by_sequence(&self, x: &Tensor) -> Tensor {
        self.packed(x, |_| 1)
    }

    /// `x` `[samples, ..]` in packed order.
    pub(crate) fn by_sample(&self, x: &Tensor) -> Tensor {
        self.packed(x, |_| self.steps)
    }

    /// `x` `[rows, ..]` in packed order.
    pub(crate) fn by_row(&self, x: &Tensor) -> Tensor {
        self.packed(x, |phases| self.steps * phases)
    }

    fn packed(&self, x: &Tensor, entries: impl Fn(i64) -> i64) -> Tensor {
        let mut starts = vec![0];
        for &phases in &self.phases {
            starts.push(starts[starts.len() - 1] + entries(phases));
        }
        assert_eq!(x.size()[0], starts[starts.len() - 1]);
        let order = &self.minibatch.batch.order;
        let index: Vec<i64> = order.iter().flat_map(|&i| starts[i]..starts[i + 1]).collect();
        x.index_select(0, &Tensor::from_slice(&index))
    }
}

impl From<JunctionJson> for Intersection {
    fn from(json: JunctionJson) -> Self {
        let lanes =
            |lanes: Vec<LaneJson>| lanes.into_iter().map(|l| Lane::new(l.id, l.length, l.speed)).collect();
        let roads = |roads: Vec<RoadJson>| {
            roads
                .into_iter()
                .map(|r| Road {
                    id: r.id,
                    length: r.length,
                    speed: r.speed,
                    lanes: r.lanes,
                    movements: r.movements,
                })
                .collect()
        };
        Self {
            id: json.id,
            position: json.position,
            incoming: lanes(json.incoming),
            outgoing: lanes(json.outgoing),
            movements: json.movements.into_iter().map(|m| Movement::new(m.incoming, m.outgoing)).collect(),
            phases: json.phases.into_iter().map(|p| Phase { state: p.state, green: p.green }).collect(),
            roads_in: roads(json.roads_in),
            roads_out: roads(json.roads_out),
        }
    }
}

impl From<FragmentJson> for Fragment {
    fn from(json: FragmentJson) -> Self {
        Self {
            id: FragmentId {
                actor: "golden".to_owned(),
                session_epoch: 1,
                episode: json.episode,
                sequence: json.sequence,
            },
            scenario: json.scenario,
            layout_hash: String::new(),
            policy_version: 1,
            first_step: json.first_step,
            steps: json.steps,
            counts: json.counts,
            phases: json.phases,
            actions: json.actions,
            log_probs: json.log_probs,
            rewards: json.rewards,
            recurrent: RecurrentState { actor: json.recurrent.actor, critic: json.recurrent.critic },
            end: match json.end {
                EndJson::Continues => FragmentEnd::Continues,
                EndJson::Truncated => FragmentEnd::Truncated,
                EndJson::Terminated => FragmentEnd::Terminated,
            },
        }
    }
}

/// The float32 tensors of a safetensors file.
pub(crate) fn tensors_of(bytes: &[u8]) -> BTreeMap<String, Tensor> {
    let file = SafeTensors::deserialize(bytes).unwrap();
    file.tensors()
        .into_iter()
        .map(|(name, view)| {
            assert_eq!(view.dtype(), safetensors::Dtype::F32, "{name}");
            let values: Vec<f32> =
                view.data().chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
            let shape: Vec<i64> = view.shape().iter().map(|&d| d as i64).collect();
            (name, Tensor::from_slice(&values).view(shape.as_slice()))
        })
        .collect()
}

/// All entries.
pub(crate) fn flat(tensor: &Tensor) -> Vec<f64> {
    let tensor = tensor.detach().to_kind(tch::Kind::Double).contiguous().view([-1]);
    let mut values = vec![0.0; tensor.numel()];
    let count = values.len();
    tensor.copy_data(&mut values, count);
    values
}
