//! Reading configs.

use kinegrad_train::config::to_toml;

use crate::BUILT_IN;

fn error(text: &str, overrides: &[&str]) -> String {
    let overrides: Vec<String> = overrides.iter().map(|s| s.to_string()).collect();
    let error = BUILT_IN
        .parse(text, "c.toml", &overrides)
        .expect_err("a bad config");
    let help = miette::Diagnostic::help(&error)
        .map(|h| h.to_string())
        .unwrap_or_default();
    format!("{error}\nhint: {help}")
}

#[test]
fn an_unknown_key_names_line_table_and_neighbour() {
    let text = error("[optim]\n\nlerning_rate = 1.0\n", &[]);
    assert!(
        text.contains("c.toml:3: unknown key `optim.lerning_rate`"),
        "{text}"
    );
    assert!(
        text.contains("did you mean `optim.learning_rate`?"),
        "{text}"
    );
}

#[test]
fn an_unknown_table_names_its_neighbour() {
    let text = error("[optin]\nlearning_rate = 1.0\n", &[]);
    assert!(text.contains("c.toml:1: unknown key `optin`"), "{text}");
    assert!(text.contains("did you mean `optim`?"), "{text}");
}

#[test]
fn a_wrong_type_names_line_and_key() {
    let text = error("[train]\nmax_steps = \"many\"\n", &[]);
    assert!(
        text.contains("c.toml:2: `train.max_steps`: expected a whole number, 0 or more"),
        "{text}"
    );
    let text = error("[train]\nmax_steps = -5\n", &[]);
    assert!(text.contains("c.toml:2: `train.max_steps`"), "{text}");
}

#[test]
fn numbers_that_no_type_holds_name_their_line() {
    for number in ["99999999999999999999", "18446744073709551615"] {
        let text = error(&format!("[run]\nname = \"x\"\nseed = {number}\n"), &[]);
        assert!(text.starts_with("c.toml:3"), "{text}");
        assert!(text.contains("too large"), "{text}");
    }
    let text = error("", &["data.batch_size=99999999999999999999999"]);
    assert!(
        text.contains("99999999999999999999999 is too large") && !text.contains("the text"),
        "{text}"
    );
}

#[test]
fn keys_with_dots_and_elements_of_lists_name_their_line() {
    for (text, place) in [
        (
            "[optim.groups]\nunet = 1e-4\n\"unet.dec\" = \"x\"\n",
            "c.toml:3: ",
        ),
        ("[model]\nchannel_mult = [\n1,\n\"x\"]\n", "c.toml:4: "),
        (
            "model.size = \"tiny\"\nmodel.dropout = \"x\"\n",
            "c.toml:2: ",
        ),
        ("[model]\nsize = \"tiny\"\n\"a.b\" = 1\n", "c.toml:3: "),
    ] {
        let error = error(text, &[]);
        assert!(error.starts_with(place), "{text}: {error}");
    }
}

#[test]
fn an_unknown_choice_names_the_nearest() {
    let text = error("[diffusion]\nbeta_schedule = \"cosin\"\n", &[]);
    assert!(text.contains("did you mean \"cosine\"?"), "{text}");
}

#[test]
fn an_override_is_blamed_for_its_own_error() {
    let text = error("", &["run.seed=3", "run.sead=3"]);
    assert!(
        text.contains("option `set run.sead=3`: unknown key `run.sead`"),
        "{text}"
    );
    assert!(error("", &["run.seed"]).contains("is not KEY=VALUE"));
}

#[test]
fn overrides_win_in_order_and_text_needs_no_quotes() {
    let overrides = ["run.seed=3", "run.device=cpu", "run.seed=4"].map(String::from);
    let config = BUILT_IN.parse("[run]\nseed = 1\n", "c.toml", &overrides);
    let config = config.expect("a good config");
    assert_eq!((config.run.seed, config.run.device.as_str()), (4, "cpu"));
}

#[test]
fn the_written_config_reads_back_equal() {
    for recipe in BUILT_IN.recipes() {
        let text = format!("[train]\nrecipe = \"{}\"", recipe.name);
        let config = BUILT_IN.parse(&text, "c.toml", &[]).expect("defaults");
        let again = BUILT_IN
            .parse(&to_toml(&config), "c.toml", &[])
            .expect("own output");
        assert_eq!(again, config);
        let json = serde_json::to_string(&config).expect("plain data");
        let mut json = serde_json::Deserializer::from_str(&json);
        let read = kinegrad_train::config::from_json(&mut json);
        assert_eq!(read.expect("own output"), config);
    }
}

#[test]
fn an_unknown_recipe_names_the_known_ones() {
    let text = error("[train]\n\nrecipe = \"gmd_movement\"\n", &[]);
    assert!(
        text.starts_with("c.toml:3: `train.recipe`: \"gmd_movement\" is not among"),
        "{text}"
    );
    assert!(
        text.contains("diffusion, decoder, e2e") && text.contains("\"gmd_motion\"?"),
        "{text}"
    );
}
