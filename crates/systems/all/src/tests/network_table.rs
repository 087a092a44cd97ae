//! The table of a network.

use crate::BUILT_IN;

fn read(model: &str) -> Result<toml::Table, (String, String)> {
    let text = format!("[train]\nrecipe = \"gmd_motion\"\n[model]\n{model}");
    let config = BUILT_IN.parse(&text, "c.toml", &[]).map_err(|error| {
        let help = miette::Diagnostic::help(&error).map(|help| help.to_string());
        (error.to_string(), help.unwrap_or_default())
    })?;
    Ok(config.system.to_table()["model"]
        .as_table()
        .expect("a table")
        .clone())
}

#[test]
fn kind_and_size_fill_in_what_is_not_said() {
    let model = read("kind = \"mdm_transformer\"\nff_size = 96").expect("a good table");
    let expected = "size = \"mdm\"\nkind = \"mdm_transformer\"\nlatent_dim = 512\n\
                    num_layers = 8\nnum_heads = 4\nff_size = 96\ndropout = 0.1\n\
                    path = false\npath_tokens = \"added\"\nactivation_checkpointing = false\n";
    assert_eq!(toml::to_string(&model).expect("plain data"), expected);
}

#[test]
fn what_is_of_another_kind_is_refused_by_its_place() {
    for (model, start, hint) in [
        (
            "\nff_size = 3",
            "c.toml:5: unknown key `model.ff_size`",
            "mdm_transformer",
        ),
        (
            "latent_dims = 3",
            "c.toml:4: unknown key",
            "`model.latent_dim`?",
        ),
        ("siz = \"mdm\"", "c.toml:4: unknown key", "`model.size`?"),
        (
            "size = \"mdm\"",
            "c.toml:4: `model.size`: \"mdm\"",
            "gmd_motion",
        ),
        (
            "kind = \"unet1d\"",
            "c.toml:4: `model.kind`: \"unet1d\"",
            "gmd_unet",
        ),
        (
            "adagn = 3",
            "c.toml:4: `model.adagn`: expected true or false, found 3",
            "",
        ),
        (
            "activation_checkpointing = 3",
            "c.toml:4: `model.activation_checkpointing`",
            "",
        ),
    ] {
        let (text, help) = read(model).expect_err(model);
        assert!(text.starts_with(start), "{text}");
        assert!(help.contains(hint), "{help}");
    }
}
