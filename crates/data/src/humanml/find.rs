//! Detection of datasets of clips.

use super::SkeletonName;
use super::clip::{FEATURES, features_path};
use super::lists::{MAX_BYTES, parse_list};
use crate::file::MAX_TENSOR_BYTES;
use crate::layout::MOTION_FILE;
use crate::npy::parse;
use crate::store::{Store, StoreError};
use crate::{DataConfig, Error};

/// Maximum number of listed clips that are read to detect the skeleton.
const LOOKED_AT: usize = 8;

/// The skeleton of a dataset in the HumanML3D layout; `Some(None)` if the skeleton is unknown,
/// `None` for another layout. Fails as [`Store::open`], and for an unreadable store.
pub fn find_clips(config: &DataConfig) -> Result<Option<Option<SkeletonName>>, Error> {
    let store = Store::open(config.source.as_deref().unwrap_or_default(), &config.store)?;
    if let Ok(Some(motion)) = store.place(MOTION_FILE.0)
        && motion.is_dir()
    {
        return Ok(None);
    }
    let list = &config.humanml3d.train_list;
    let found = match store.find(list, MAX_BYTES) {
        // A bucket denies access to missing objects if the user may not list it.
        Err(StoreError::Denied { .. }) => None,
        found => found?,
    };
    let Some(bytes) = found else {
        // Opening a copy without its list reports the missing list.
        let features = store.place(FEATURES)?;
        return Ok(features.filter(|folder| folder.is_dir()).map(|_| None));
    };
    let ids = parse_list(&bytes, list).unwrap_or_default().into_iter();
    let mut skeletons = ids.take(LOOKED_AT).filter_map(|(_, id)| {
        let path = features_path(&id);
        let array = parse(&store.find(&path, MAX_TENSOR_BYTES).ok()??, &path).ok()?;
        SkeletonName::of_channels(*array.shape.get(1)?)
    });
    Ok(Some(skeletons.next()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::humanml::write_walks;
    use crate::npy::write_values;
    use crate::synthetic;

    fn found(folder: &std::path::Path) -> Option<Option<SkeletonName>> {
        let config = DataConfig {
            source: Some(folder.display().to_string()),
            ..DataConfig::default()
        };
        find_clips(&config).unwrap()
    }

    #[test]
    fn layouts_and_skeletons_are_distinguished() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        assert_eq!(found(&at("nowhere")), None);
        synthetic::write_dataset(&at("phrases"), crate::AudioLayout::CCMOTION, 2, 30, 0).unwrap();
        assert_eq!(found(&at("phrases")), None);
        write_walks(&at("walks"), 2, 60, 0).unwrap();
        assert_eq!(found(&at("walks")), Some(Some(SkeletonName::Humanml3d)));
        std::fs::create_dir_all(at("kit").join(FEATURES)).unwrap();
        assert_eq!(found(&at("kit")), Some(None));
        std::fs::write(at("kit").join("train.txt"), "missing\n00001\n").unwrap();
        let clip = at("kit").join(features_path("00001"));
        write_values(&clip, &[3, 251], &[0.0; 3 * 251]).unwrap();
        assert_eq!(found(&at("kit")), Some(Some(SkeletonName::Kit)));
    }
}
