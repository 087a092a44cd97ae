//! Validation of the table `data` for clips.

use kinegrad_settings::{InvalidSetting, Refused, in_range, require};

use super::{DataConfig, DataKind, MIN_FRAMES, StatisticsOf};
use crate::humanml::SkeletonName;

/// Validates the table `humanml3d` and the other keys of `data` for clips.
pub(super) fn validate(data: &DataConfig) -> Result<(), InvalidSetting> {
    let clips = &data.humanml3d;
    let (unit, least) = (clips.unit_frames, clips.unit_frames.max(MIN_FRAMES));
    in_range("data.humanml3d.unit_frames", unit, 1..=data.target_frames)
        .hint("at most `data.target_frames`; 4 in the published training")?;
    let lengths = least..=crate::MAX_FRAMES;
    in_range("data.humanml3d.min_frames", clips.min_frames, lengths)
        .hint("40 for HumanML3D, 24 for KIT-ML; at least `data.humanml3d.unit_frames`")?;
    if let Some(fps) = clips.fps {
        in_range("data.humanml3d.fps", fps, 1.0..=1000.0)
            .hint("20 for HumanML3D, 12.5 for KIT-ML, 30 for BABEL")?;
    }
    let longer = clips.min_frames + 1..;
    in_range("data.humanml3d.max_frames", clips.max_frames, longer).hint(
        "more than `data.humanml3d.min_frames`; clips of max_frames and more are left out: 200 \
         in the published training",
    )?;
    let listed = !clips.train_list.is_empty();
    let allowed = "a file within the dataset";
    require(listed, "data.humanml3d.train_list", "\"\"", allowed)
        .hint("\"train.txt\" in HumanML3D")?;
    validate_no_phrase_settings(data)?;
    match data.kind {
        DataKind::SyntheticWalks => validate_walks(data),
        _ => validate_split(data),
    }
}

fn validate_walks(data: &DataConfig) -> Result<(), InvalidSetting> {
    let clips = &data.humanml3d;
    require(
        clips.skeleton == SkeletonName::Humanml3d,
        "data.humanml3d.skeleton",
        format!("\"{}\"", clips.skeleton),
        "\"humanml3d\" with data.kind = \"synthetic_walks\"",
    )
    .hint("leave the key out")?;
    let lengths = clips.min_frames..clips.max_frames;
    in_range("data.synthetic.frames", data.synthetic.frames, lengths).hint(
        "walks keep to `data.humanml3d.min_frames` and `max_frames`; 20 frames are one second",
    )
}

/// The split of a HumanML3D dataset comes from its lists only.
fn validate_split(data: &DataConfig) -> Result<(), InvalidSetting> {
    let split = &data.validation;
    for (key, set) in [
        ("fraction", split.fraction.is_some()),
        ("patterns", !split.patterns.is_empty()),
        ("ids_file", split.ids_file.is_some()),
    ] {
        require(!set, key, "set", "nothing with data.kind = \"humanml3d\"")
            .within("data.validation")
            .hint("the dataset's lists decide: data.humanml3d.train_list and validation_list")?;
    }
    Ok(())
}

/// Rejects settings of phrases.
fn validate_no_phrase_settings(data: &DataConfig) -> Result<(), InvalidSetting> {
    let augment = &data.augment;
    let alone = "clips have no neighbours";
    let whole = "the statistics of clips are those of whole clips";
    let silent = "clips have no music";
    let anchored = "every sample begins at the origin facing +z";
    let mirrored = "a HumanML3D copy lists its mirrored clips beside the others";
    let turned = "features contain no quaternions";
    let long = "data.humanml3d.unit_frames sets the length of samples";
    let timed = "clips have the speed that their captions describe";
    let measured = data.statistics != StatisticsOf::Phrases;
    let replaced = augment.audio_replace_prob != 0.0;
    let dropped = augment.bar_drop_prob != 0.0;
    for (key, set, hint) in [
        ("join_neighbours", data.join_neighbours, alone),
        ("statistics", measured, whole),
        ("audio_features", data.audio_layout().beats, silent),
        ("augment.rotate_yaw", augment.rotate_yaw, anchored),
        ("augment.mirror", augment.mirror, mirrored),
        ("augment.flip_quaternion", augment.flip_quaternion, turned),
        ("augment.min_frames", augment.min_frames.is_some(), long),
        ("augment.audio_noise", augment.audio_noise != 0.0, silent),
        ("augment.audio_masks", augment.audio_masks != 0, silent),
        ("augment.audio_replace_prob", replaced, silent),
        ("augment.bar_drop_prob", dropped, silent),
        ("augment.speed", augment.speed != 0.0, timed),
    ] {
        let found = "a setting of phrases";
        require(!set, key, found, "only the default with clips")
            .within("data")
            .hint(hint)?;
    }
    Ok(())
}
