//! What machines say to each other, as JSON on subjects of NATS.

use std::time::Duration;

use async_nats::jetstream;
use async_nats::jetstream::consumer::pull;
use glam::Vec3;
use rebake_core::layers::LayerLight;
use rebake_core::{LayerHeader, PartSpec};
use serde::{Deserialize, Serialize};

/// Raised with every change of these messages or of what they name. Machines of other formats leave each other alone.
pub(super) const FORMAT: u32 = 3;

/// The work queue, and the consumer that all workers share.
const STREAM: &str = "rebake-parts";
const CONSUMER: &str = "rebake-workers";

/// A worker that is not heard of for so long has died: the queue gives its part to another.
pub(super) const SILENCE: Duration = Duration::from_secs(30);

/// How often a worker tells that it is at work.
pub(super) const HEARTBEAT: Duration = Duration::from_secs(3);

/// A part is given to so many workers at most, one after the other.
const MOST_DELIVERIES: i64 = 5;

/// Parts that nobody has asked for by then are of bakes long gone.
const OLDEST: Duration = Duration::from_secs(3600);

/// A part of a round of a bake, for whoever takes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Task {
    pub(super) format: u32,
    /// Which offer it is of: results go to its subject and folder.
    pub(super) offer: String,
    /// Hash of the file that tells how the scene came to be ([`super::snapshot::Manifest`]).
    pub(super) snapshot: String,
    /// Of the bake.
    pub(super) seed: u64,
    pub(super) layers: Vec<TaskLayer>,
    /// Hash of the file of how many times the samples each slot gets; none where all get them once.
    pub(super) effort: Option<String>,
    pub(super) round: u32,
    pub(super) part: u32,
    pub(super) samples: u32,
    /// Workers that have given nonsense.
    #[serde(default)]
    pub(super) refused: Vec<String>,
}

/// A layer without its values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct TaskLayer {
    name: String,
    /// Names of lights with the bits of their reference strengths.
    lights: Vec<(String, [u32; 3])>,
}

impl From<&LayerHeader> for TaskLayer {
    fn from(header: &LayerHeader) -> TaskLayer {
        let light = |light: &LayerLight| (light.name.clone(), light.reference.to_array().map(f32::to_bits));
        TaskLayer { name: header.name.clone(), lights: header.lights.iter().map(light).collect() }
    }
}

impl From<&TaskLayer> for LayerHeader {
    fn from(layer: &TaskLayer) -> LayerHeader {
        let light = |(name, bits): &(String, [u32; 3])| LayerLight {
            name: name.clone(),
            reference: Vec3::from(bits.map(f32::from_bits)),
        };
        LayerHeader { name: layer.name.clone(), lights: layer.lights.iter().map(light).collect() }
    }
}

impl Task {
    pub(super) fn spec(&self) -> PartSpec {
        PartSpec { round: self.round, part: self.part, samples: self.samples }
    }

    /// Where its result is kept.
    pub(super) fn result_path(&self, worker: &str) -> String {
        format!("{}/{}-{worker}", results_folder(&self.offer), self.part)
    }
}

/// What a worker says of a task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct News {
    pub(super) worker: String,
    pub(super) round: u32,
    pub(super) part: u32,
    pub(super) what: What,
}

/// How far a worker is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum What {
    /// It is at work.
    Working,
    /// The result is kept.
    Done {
        /// Of the result's bytes.
        hash: String,
        /// That it took.
        ms: u64,
    },
    /// It cannot do it.
    Failed {
        /// Why.
        reason: String,
    },
}

/// Folder of the results of an offer.
pub(super) fn results_folder(offer: &str) -> String {
    format!("parts/{offer}")
}

/// Subject of the tasks of an offer.
pub(super) fn tasks_subject(offer: &str) -> String {
    format!("rebake.parts.{offer}")
}

/// Subject of what workers say of the tasks of an offer, whose id begins with its coordinator's and a dot.
pub(super) fn news_subject(offer: &str) -> String {
    format!("rebake.news.{offer}")
}

/// Subject on which workers tell every few seconds that they are there; the payload is the worker's name.
pub(super) const PRESENCE_SUBJECT: &str = "rebake.workers";

/// Subject of offers that nobody waits for any more; the payload is the offer's id.
pub(super) const CLOSED_SUBJECT: &str = "rebake.closed";

/// The queue of tasks, made where it is not there yet.
pub(super) async fn stream(context: &jetstream::Context) -> Result<jetstream::stream::Stream, super::ClusterError> {
    let config = jetstream::stream::Config {
        name: STREAM.to_owned(),
        subjects: vec![tasks_subject("*.*")],
        retention: jetstream::stream::RetentionPolicy::WorkQueue,
        max_age: OLDEST,
        ..Default::default()
    };
    context.get_or_create_stream(config).await.map_err(super::ClusterError::queue)
}

/// What all workers take tasks from.
pub(super) async fn consumer(
    stream: &jetstream::stream::Stream,
) -> Result<jetstream::consumer::Consumer<pull::Config>, super::ClusterError> {
    let config = pull::Config {
        durable_name: Some(CONSUMER.to_owned()),
        ack_wait: SILENCE,
        max_deliver: MOST_DELIVERIES,
        ..Default::default()
    };
    stream.get_or_create_consumer(CONSUMER, config).await.map_err(super::ClusterError::queue)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_come_over_with_every_bit() {
        let light = |name: &str, x: f32| LayerLight { name: name.to_owned(), reference: Vec3::new(x, -0.0, f32::MIN) };
        let header = LayerHeader { name: "Decke".to_owned(), lights: vec![light("a", 1e-30), light("b", f32::MAX)] };
        let layer = TaskLayer::from(&header);
        let back: TaskLayer = serde_json::from_str(&serde_json::to_string(&layer).unwrap()).unwrap();
        assert_eq!(LayerHeader::from(&back), header);
        assert!(LayerHeader::from(&back).lights[0].reference.y.is_sign_negative());
    }

    #[test]
    fn news_are_words_that_stay() {
        let news = News { worker: "w".into(), round: 1, part: 2, what: What::Done { hash: "h".into(), ms: 3 } };
        let text = r#"{"worker":"w","round":1,"part":2,"what":{"done":{"hash":"h","ms":3}}}"#;
        assert_eq!(serde_json::to_string(&news).unwrap(), text);
        let working: News = serde_json::from_str(r#"{"worker":"w","round":0,"part":0,"what":"working"}"#).unwrap();
        assert_eq!(working.what, What::Working);
    }
}
