use kinegrad_motion::humanml::Skeleton;

/// The limb and the depth of each joint of a skeleton ("kinematic hierarchy"; docs/sources.md,
/// section 5).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hierarchy {
    /// The chain of each joint, `[J]`. A joint is not on chains that begin at the joint, except the
    /// root, which is on the longest such chain.
    pub chains: Vec<usize>,
    /// Steps from the root to each joint, `[J]`.
    pub depths: Vec<usize>,
}

impl Hierarchy {
    /// The hierarchy of a skeleton.
    pub fn of(skeleton: &Skeleton) -> Self {
        let all = &skeleton.description().chains;
        let root = skeleton.parents().iter().position(Option::is_none);
        let trunk = (0..all.len())
            .rev()
            .filter(|&chain| all[chain].first().copied() == root)
            .max_by_key(|&chain| all[chain].len());
        let mut chains = vec![trunk.unwrap_or(0); skeleton.joints()];
        for (chain, joints) in all.iter().enumerate() {
            for &joint in joints.iter().skip(1) {
                chains[joint] = chain;
            }
        }
        let depth = |joint: usize| {
            let up = |&joint: &usize| skeleton.parents()[joint];
            std::iter::successors(Some(joint), up).count() - 1
        };
        Self {
            chains,
            depths: (0..skeleton.joints()).map(depth).collect(),
        }
    }

    /// Number of chains.
    pub fn num_chains(&self) -> usize {
        self.chains.iter().max().map_or(0, |chain| chain + 1)
    }

    /// Number of depths.
    pub fn num_depths(&self) -> usize {
        self.depths.iter().max().map_or(0, |depth| depth + 1)
    }
}
