//! Errors and atomic writing of exported files.

use std::path::{Path, PathBuf};

use miette::Diagnostic;

use crate::scene::Scene;

/// Errors of exports.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum ExportError {
    /// The scene is empty or not finite.
    #[error("{}: {problem}", out.display())]
    #[diagnostic(help("give a motion of at least one frame whose numbers are finite"))]
    Scene {
        /// The file that was to be written.
        out: PathBuf,
        /// The problem.
        problem: String,
    },
    /// The skeleton of the joints is unknown.
    #[error("{}: the skeleton of `{object}` is not known", out.display())]
    #[diagnostic(help(
        "GIF, MP4 and GLB files show bones, and the bones between the {joints} joints are not known: give a \
         BVH file, or joint positions of a known skeleton (22 joints of HumanML3D, 21 of KIT-ML); \
         a page shows any joints as points"
    ))]
    NoSkeleton {
        /// The file that was to be written.
        out: PathBuf,
        /// Name of the object.
        object: String,
        /// Number of its joints.
        joints: usize,
    },
    /// The motion has too many pictures for a video or animated picture.
    #[error(
        "{}: {seconds:.0} s have {pictures} pictures, at most {} are written",
        out.display(),
        MOST_PICTURES
    )]
    #[diagnostic(help(
        "give a shorter motion; if it is none, its frame rate is wrong: a BVH file states seconds for \
         each frame, as `Frame Time: 0.033333`"
    ))]
    TooLong {
        /// The file that was to be written.
        out: PathBuf,
        /// Length of the motion in seconds.
        seconds: f64,
        /// Number of pictures.
        pictures: usize,
    },
    /// An object has more nodes than a skin of glTF can name.
    #[error("{}: `{object}` needs {nodes} nodes, at most {} are written", out.display(), MOST_NODES)]
    #[diagnostic(help("glTF counts the joints of a skin in 16 bits: leave joints out"))]
    TooManyJoints {
        /// The file that was to be written.
        out: PathBuf,
        /// Name of the object.
        object: String,
        /// Number of nodes.
        nodes: usize,
    },
    /// Stopped by the caller.
    #[error("{}: interrupted, nothing is written", out.display())]
    Interrupted {
        /// The file that was to be written.
        out: PathBuf,
    },
    /// The file cannot be written.
    #[error("cannot write {}: {reason}", path.display())]
    #[diagnostic(help("check that its folder exists and can be written"))]
    Write {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        reason: String,
    },
    /// `ffmpeg` is missing.
    #[error("{}: `{program}` cannot be started: {reason}", out.display())]
    #[diagnostic(help(
        "ffmpeg encodes MP4 files: install it (`apt-get install ffmpeg`, `brew install ffmpeg`) on the \
         PATH, or write a GIF"
    ))]
    NoEncoder {
        /// The file that was to be written.
        out: PathBuf,
        /// The program.
        program: String,
        /// What went wrong.
        reason: String,
    },
    /// `ffmpeg` failed.
    #[error("{}: ffmpeg failed ({status}): {last_lines}", out.display())]
    #[diagnostic(help(
        "MP4 files need an ffmpeg with the encoders libx264 and aac that can read the song; otherwise \
         write a GIF"
    ))]
    Encoder {
        /// The file that was to be written.
        out: PathBuf,
        /// Exit status of `ffmpeg`.
        status: String,
        /// The last lines of its messages.
        last_lines: String,
    },
}

/// Most pictures of a video or animated picture: a day at 30 a second.
pub(crate) const MOST_PICTURES: usize = 24 * 3600 * 30;

/// Most nodes of an object in a glTF file.
pub(crate) const MOST_NODES: usize = 1 << 16;

/// Called with the number of finished pictures and of all; returns true to stop.
pub type Stop<'a> = &'a dyn Fn(usize, usize) -> bool;

impl ExportError {
    /// Turns the reason why `path` cannot be written into an error.
    pub(crate) fn write<E: ToString>(path: &Path) -> impl Fn(E) -> Self {
        move |reason| Self::Write {
            path: path.to_path_buf(),
            reason: reason.to_string(),
        }
    }
}

/// Checks the number of pictures of a scene.
///
/// # Errors
/// [`ExportError::TooLong`].
pub(crate) fn check_pictures(
    scene: &Scene,
    pictures: usize,
    out: &Path,
) -> Result<(), ExportError> {
    match pictures > MOST_PICTURES {
        true => Err(ExportError::TooLong {
            out: out.to_path_buf(),
            seconds: scene.seconds(),
            pictures,
        }),
        false => Ok(()),
    }
}

/// Checks that a scene can be written to `out` as a GIF, MP4 or GLB file.
///
/// # Errors
/// [`ExportError::Scene`] without frames or with values that are not finite,
/// [`ExportError::NoSkeleton`] for joints without parents.
pub fn check(scene: &Scene, out: &Path) -> Result<(), ExportError> {
    let refused = |problem: String| ExportError::Scene {
        out: out.to_path_buf(),
        problem,
    };
    if scene.objects.is_empty() {
        return Err(refused("there is no motion".into()));
    }
    for object in &scene.objects {
        let name = &object.name;
        if object.frames() == 0 {
            return Err(refused(format!("`{name}` has no frames")));
        }
        if !(object.fps.is_finite() && object.fps > 0.0) {
            let fps = object.fps;
            return Err(refused(format!("`{name}` has {fps} frames a second")));
        }
        let hang = object.parents.iter().enumerate();
        let (mut hang, joints) = (hang.skip(1), object.joints());
        if !hang.all(|(joint, parent)| parent.is_some_and(|p| p < joints && p != joint)) {
            return Err(ExportError::NoSkeleton {
                out: out.to_path_buf(),
                object: name.clone(),
                joints,
            });
        }
        let turns = object.orientations.iter().flatten().flatten();
        let mut numbers = object.positions.iter().chain(turns);
        if !numbers.all(|number| number.is_finite()) {
            return Err(refused(format!("`{name}` is not finite throughout")));
        }
    }
    Ok(())
}

/// Writes a file atomically.
pub(crate) fn write(out: &Path, bytes: &[u8]) -> Result<(), ExportError> {
    kinegrad_output::write(out, bytes).map_err(ExportError::write(out))
}
