//! Parameter counts.

use burn::module::Module;
use kinegrad_models::parameters::{self, ParameterInfo};
use serde::Serialize;

/// Parameter counts of a run's networks.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ParameterCount {
    /// All parameters: trained, frozen and adapters.
    pub all: usize,
    /// The trained parameters.
    pub trained: usize,
    /// The parameters of low-rank adapters.
    pub adapters: usize,
    /// All parameters by network; empty for a single network.
    pub networks: Vec<(String, usize)>,
}

impl ParameterCount {
    /// The counts of a single network that is trained completely.
    pub fn trained<M: Module>(network: &M) -> Self {
        let all = parameters::count(network);
        Self {
            all,
            trained: all,
            ..Self::default()
        }
    }

    /// The counts of `infos`. A parameter's name starts with the name of its network, one of
    /// `networks`, and a dot.
    pub fn of(
        infos: &[ParameterInfo],
        networks: &[&str],
        is_trained: impl Fn(usize, &ParameterInfo) -> bool,
    ) -> Self {
        let mut count = Self::default();
        for (index, info) in infos.iter().enumerate() {
            count.all += info.len();
            count.trained += info.len() * usize::from(is_trained(index, info));
            count.adapters += info.len() * usize::from(is_adapter(info));
        }
        for &name in networks {
            let own = infos
                .iter()
                .filter(|info| info.name.split('.').next() == Some(name));
            let own = own.map(ParameterInfo::len).sum();
            if own > 0 {
                count.networks.push((name.to_string(), own));
            }
        }
        count
    }
}

/// True if a parameter belongs to a low-rank adapter.
pub fn is_adapter(info: &ParameterInfo) -> bool {
    info.name.split('.').any(|part| part == "lora")
}
