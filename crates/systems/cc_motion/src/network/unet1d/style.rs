//! The style condition of the UNet: eight numbers, a label of the dance, or both.

use burn::module::Module;
use burn::tensor::Tensor;
use burn::tensor::activation::silu;
use kinegrad_models::Initializer;
use kinegrad_models::layers::Linear;
use kinegrad_models::lora::{Adapting, LoraTarget};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Values of a style's numbers: eight normalized numbers, and 1.
pub const STYLE_VALUES: usize = 9;

/// The style condition (CC-MotionGen, section 15.2, plans style control for version 0.4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum StyleConditioning {
    /// Nothing.
    #[default]
    None,
    /// The phrase's eight style numbers, the mean of its style channels over the sample's frames.
    Numbers,
    /// The phrase's label, such as `waltz`.
    Label,
    /// Numbers and label; either can be omitted.
    Both,
}

impl StyleConditioning {
    /// True if the numbers are a condition.
    pub fn has_numbers(self) -> bool {
        matches!(self, Self::Numbers | Self::Both)
    }

    /// True if the label is a condition.
    pub fn has_label(self) -> bool {
        matches!(self, Self::Label | Self::Both)
    }
}

/// The style of each sample of a batch. Zeros are the null style; `None` is null for all samples.
#[derive(Clone, Debug)]
pub struct StyleCondition {
    /// The eight normalized numbers, and 1: `[batch, 9]`.
    pub numbers: Option<Tensor<2>>,
    /// One-hot label of each sample: `[batch, labels]`.
    pub label: Option<Tensor<2>>,
}

impl StyleCondition {
    /// The null style.
    #[must_use]
    pub fn null(&self) -> Self {
        self.map(Tensor::zeros_like)
    }

    /// This style of one sample, repeated for `batch` samples.
    pub(crate) fn repeated(&self, batch: usize) -> Self {
        self.map(|values| values.clone().repeat_dim(0, batch))
    }

    fn map(&self, change: impl Fn(&Tensor<2>) -> Tensor<2>) -> Self {
        Self {
            numbers: self.numbers.as_ref().map(&change),
            label: self.label.as_ref().map(&change),
        }
    }
}

/// The embedding of the style, added to the timestep embedding like class labels in ADM (Dhariwal
/// and Nichol 2021, <https://arxiv.org/abs/2105.05233>):
///
/// ```text
/// Linear(silu(Linear(numbers))) + Linear(label)
/// ```
///
/// The learned biases determine the embedding of the null style.
#[derive(Module, Debug)]
pub(super) struct StyleEmbedding {
    numbers_at_0: Option<Linear>,
    numbers_at_2: Option<Linear>,
    label: Option<Linear>,
}

impl StyleEmbedding {
    /// An embedding of width `width` for a style of these parts; `None` without style.
    pub fn new(
        style: StyleConditioning,
        labels: usize,
        width: usize,
        init: &Initializer,
    ) -> Option<Self> {
        let layer = |there: bool, inputs, init: Initializer| {
            there.then(|| Linear::new(inputs, width, &init))
        };
        let (has_numbers, numbers) = (style.has_numbers(), init.at("numbers"));
        (style != StyleConditioning::None).then(|| Self {
            numbers_at_0: layer(has_numbers, STYLE_VALUES, numbers.at("0")),
            numbers_at_2: layer(has_numbers, width, numbers.at("2")),
            label: layer(style.has_label(), labels, init.at("label")),
        })
    }

    /// Adds the embedding of `style`; `None` is the null style.
    ///
    /// # Shapes
    /// - time_emb, output: `[batch, width]`, the time embedding without and with the style
    pub fn add_to(&self, time_emb: Tensor<2>, style: Option<&StyleCondition>) -> Tensor<2> {
        let (batch, device) = (time_emb.dims()[0], time_emb.device());
        let or_null = |values: Option<&Tensor<2>>, width: usize| match values {
            Some(values) => values.clone(),
            None => Tensor::zeros([batch, width], &device),
        };
        let mut sum = time_emb;
        if let (Some(first), Some(second)) = (&self.numbers_at_0, &self.numbers_at_2) {
            let numbers = style.and_then(|style| style.numbers.as_ref());
            let h = silu(first.forward(or_null(numbers, STYLE_VALUES)));
            sum = sum + second.forward(h);
        }
        if let Some(layer) = &self.label {
            let label = style.and_then(|style| style.label.as_ref());
            sum = sum + layer.forward(or_null(label, layer.inputs()));
        }
        sum
    }

    pub fn adapting(self, adapting: &Adapting<'_>) -> Self {
        let layer = |name: &str, layer: Option<Linear>| {
            layer.map(|layer| adapting.layer(LoraTarget::Conditioning, name, layer))
        };
        Self {
            numbers_at_0: layer("numbers.0", self.numbers_at_0),
            numbers_at_2: layer("numbers.2", self.numbers_at_2),
            label: layer("label", self.label),
        }
    }
}
