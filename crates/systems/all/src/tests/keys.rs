//! The descriptions of the keys of all systems.

use crate::BUILT_IN;

#[test]
fn every_key_of_every_resolved_config_is_described() {
    let described = BUILT_IN.described();
    for variant in BUILT_IN.variants() {
        let names = variant.names();
        assert!(names.len() > 80);
        for name in names {
            let known = described.iter().find(|(key, recipes)| {
                key.name == name
                    && recipes.contains(&variant.recipe)
                    && variant.has(key.only_with.as_deref())
            });
            let (key, _) = known.unwrap_or_else(|| panic!("{name} of {}", variant.recipe));
            assert!(key.meaning.len() > 4, "{name}: {:?}", key.meaning);
        }
    }
}

#[test]
fn defaults_are_told_by_recipe() {
    let keys = BUILT_IN.keys();
    let of = |name: &str| {
        &keys
            .iter()
            .find(|key| key.key.name == name)
            .expect(name)
            .defaults
    };
    assert_eq!(of("run.seed").len(), 1);
    assert_eq!(of("run.seed")[0].1, "42");
    assert_eq!(of("data.source")[0].1, "not set");
    assert_eq!(of("lora.rank")[0].1, "8");
    assert_eq!(of("train.recipe").len(), 1);
    assert_eq!(of("train.recipe")[0].1, "\"diffusion\"");
    let kinds = keys.iter().filter(|key| key.key.name == "model.kind");
    let kinds: Vec<_> = kinds.map(|key| key.defaults.as_slice()).collect();
    let gmd = [(vec!["gmd_motion", "gmd_trajectory"], "\"gmd_unet\"".into())];
    assert!(kinds.contains(&&gmd[..]), "{kinds:?}");
    assert!(
        kinds.iter().all(|defaults| defaults.len() == 1),
        "{kinds:?}"
    );
    let steps = of("train.max_steps");
    assert!(
        steps.contains(&(vec!["gmd_trajectory"], "62500".into())),
        "{steps:?}"
    );
}

#[test]
fn ranges_are_those_of_the_validation() {
    let keys = BUILT_IN.keys();
    let range = |name: &str| {
        let mut key = [keys
            .iter()
            .find(|key| key.key.name == name)
            .expect(name)
            .clone()];
        BUILT_IN.find_ranges(&mut key);
        key[0].range.clone()
    };
    assert_eq!(range("data.batch_size").as_deref(), Some("1 to 65536"));
    assert_eq!(range("optim.betas").as_deref(), Some("0 to below 1"));
    assert_eq!(range("lora.rank").as_deref(), Some("1 to 65536"));
    assert_eq!(range("run.seed"), None);
    assert_eq!(range("run.device"), None);
}
