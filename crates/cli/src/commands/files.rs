//! The files of samples.

use std::fs;
use std::path::{MAIN_SEPARATOR, Path, PathBuf};

use kinegrad_capture::Bvh;
use kinegrad_data::{write_values, write_whole};
use kinegrad_motion::feet::{ContactRule, hold};
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_train::Error;
use kinegrad_train::sampling::{Contents, Drawn, Names, Receiver, Record};
use serde::Serialize;

use crate::interrupt;
use crate::output::unusable;
use crate::progress::Denoising;

/// Units of a BVH file in a metre.
pub const CENTIMETRES: f64 = 100.0;

/// Extension of a sample's record.
const RECORD: &str = ".json";

/// A sample that was written.
#[derive(Serialize)]
pub struct Written {
    /// Its files, the motion first and the record last.
    pub files: Vec<PathBuf>,
    /// How it was made.
    pub record: Record,
}

/// What is done with files that exist.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// Nothing is drawn.
    Refused,
    /// They are replaced.
    Replaced,
}

/// Writes motion to files of one stem, and a record beside each.
pub struct Files {
    stem: String,
    existing: Existing,
    bar: Option<Denoising>,
    /// What is done with each sample that was written.
    tell: fn(&Written),
    keeps: bool,
    /// Whether it is said where a file is not exact.
    notes: bool,
    /// Whether the feet of BVH files are held where they stand.
    lock_feet: bool,
    kept: Vec<Written>,
    written: usize,
}

impl Files {
    /// Files with the prefix `out`; each is printed.
    ///
    /// # Errors
    /// If `out` names a folder: the files would have no name.
    pub fn new(out: &Path, existing: Existing) -> Result<Self, Error> {
        let text = out.to_string_lossy();
        let stem = text.strip_suffix(".npy").unwrap_or(&text);
        let name = stem.rsplit(['/', MAIN_SEPARATOR]).next();
        if matches!(name, None | Some("" | "." | "..")) {
            let folder = match stem {
                "" => "./",
                folder => folder,
            };
            return Err(Error::usage(
                format!(
                    "`--out {text}` names no file: it is the beginning of a path, such as dances/one"
                ),
                format!(
                    "for files in that folder: `--out {}`",
                    Path::new(folder).join("sample").display()
                ),
            ));
        }
        Ok(Self {
            stem: stem.to_string(),
            existing,
            notes: true,
            tell: |written| {
                for file in &written.files {
                    say!("{}", file.display());
                }
            },
            ..Self::silent(Path::new(""))
        })
    }

    /// The same, not printed but [kept](Self::kept).
    #[must_use]
    pub fn keeping(self) -> Self {
        Self {
            tell: |_| {},
            keeps: true,
            ..self
        }
    }

    /// The same with the feet of BVH files held where they stand, if `lock_feet`.
    #[must_use]
    pub fn locking_feet(self, lock_feet: bool) -> Self {
        Self { lock_feet, ..self }
    }

    /// Files in `folder` that are not printed.
    pub fn silent(folder: &Path) -> Self {
        Self {
            stem: format!("{}/", folder.display()),
            existing: Existing::Replaced,
            bar: None,
            tell: |_| {},
            keeps: false,
            notes: false,
            lock_feet: false,
            kept: Vec::new(),
            written: 0,
        }
    }

    /// Motions written so far.
    pub fn written(&self) -> usize {
        self.written
    }

    /// The samples that were written, if they are kept.
    pub fn kept(self) -> Vec<Written> {
        self.kept
    }

    fn path(&self, name: &str, extension: &str) -> PathBuf {
        PathBuf::from(format!("{}{name}{extension}", self.stem))
    }

    /// Where the motion of a sample is written.
    pub fn motion_path(&self, drawn: &Drawn) -> PathBuf {
        let extension = drawn.files.first().map_or("", |(extension, _)| extension);
        self.path(&drawn.name, extension)
    }

    /// Writes all files of a sample and returns them, the motion first and the record last; or
    /// removes those that were written.
    ///
    /// # Errors
    /// If one cannot be written.
    pub fn write(&self, drawn: &Drawn) -> Result<Vec<PathBuf>, Error> {
        let mut files = Vec::with_capacity(drawn.files.len() + 1);
        let mut write = || {
            for (extension, contents) in &drawn.files {
                let path = self.path(&drawn.name, extension);
                self.write_contents(&path, contents)?;
                files.push(path);
            }
            let path = self.path(&drawn.name, RECORD);
            let record = serde_json::to_string_pretty(&drawn.record).expect("plain data") + "\n";
            write_whole(&path, record.as_bytes())?;
            files.push(path);
            Ok(())
        };
        match write() {
            Ok(()) => Ok(files),
            Err(error) => {
                for file in files {
                    let _ = fs::remove_file(file);
                }
                Err(error)
            }
        }
    }

    fn write_contents(&self, path: &Path, contents: &Contents) -> Result<(), Error> {
        match contents {
            Contents::Array { shape, values } => write_values(path, shape, values)?,
            Contents::Figure { joints, skeleton } => {
                let bvh = bvh(joints, skeleton)?;
                if self.notes {
                    note_deviation(path, &bvh, joints, skeleton);
                }
                let bvh = match self.lock_feet {
                    true => with_locked_feet(path, &bvh, joints, skeleton)?,
                    false => bvh,
                };
                write_whole(path, bvh.to_text().as_bytes())?;
            }
        }
        Ok(())
    }
}

/// Rejects a motion whose numbers are not finite; `stem` begins the names of its files.
///
/// # Errors
/// Names the first file.
pub fn must_be_finite(drawn: &Drawn, stem: &str) -> Result<(), Error> {
    for (extension, contents) in &drawn.files {
        if let Contents::Array { values, .. } = contents
            && !values.iter().all(|value| value.is_finite())
        {
            let sample = format!("{stem}{}{extension}", drawn.name);
            return Err(Error::SampleNotFinite { sample });
        }
    }
    Ok(())
}

/// The text of the BVH file of joint positions, in centimetres.
///
/// # Errors
/// If they cannot be written as BVH.
pub fn bvh_text(joints: &Joints, skeleton: &Skeleton) -> Result<String, Error> {
    Ok(bvh(joints, skeleton)?.to_text())
}

/// Joint positions as BVH, in centimetres.
///
/// # Errors
/// If they cannot be written as BVH.
pub fn bvh(joints: &Joints, skeleton: &Skeleton) -> Result<Bvh, Error> {
    Bvh::from_joints(joints, skeleton, CENTIMETRES).map_err(unusable)
}

/// What a BVH file may differ from its clip without a word, metres.
const EXACT: f64 = 1e-3;

/// Says how far the joints of a BVH file are from those it was made of, where that is noticeable.
pub fn note_deviation(path: &Path, bvh: &Bvh, joints: &Joints, skeleton: &Skeleton) {
    let deviation = bvh.deviation(joints, skeleton, CENTIMETRES);
    if let Some(worst) = deviation.filter(|worst| worst.metres > EXACT) {
        tell!(
            "note: {}: joints are up to {:.3} m from the motion's (`{}` in frame {}), as its bones \
             change their lengths, which BVH cannot hold; `kinegrad view MOTION.npy --glb FILE.glb` \
             writes them exactly",
            path.display(),
            worst.metres,
            worst.joint,
            worst.frame
        );
    }
}

/// `bvh`, which was made of `joints` and will be at `path`, with feet that stay where they stand in
/// them; says how far they slid.
///
/// # Errors
/// If the joints are not those of the skeleton.
pub fn with_locked_feet(
    path: &Path,
    bvh: &Bvh,
    joints: &Joints,
    skeleton: &Skeleton,
) -> Result<Bvh, Error> {
    // Bones of one length, which the clip's need not have: locked before, feet would slide again.
    let rigid = bvh.joints_of(skeleton, CENTIMETRES);
    let rigid = rigid.expect("a file that was made of these joints");
    let held = hold(&rigid, joints, skeleton, &ContactRule::default())?;
    let short = match held.missed > EXACT {
        true => format!("; legs are up to {:.3} m too short to stay", held.missed),
        false => String::new(),
    };
    tell!(
        "note: {}: feet stand in {:.0} % of the frames and slid by {:.2} m/s meanwhile, now by {:.2} \
         m/s{short}",
        path.display(),
        100.0 * held.in_contact,
        held.before,
        held.after
    );
    self::bvh(&held.joints, skeleton)
}

/// Extension of BVH files.
const BVH: &str = ".bvh";

impl Receiver for Files {
    fn stepped(&mut self, stage: &'static str, done: usize, all: usize) {
        let bar = self.bar.get_or_insert_with(|| Denoising::of(""));
        bar.show(stage, done, all);
    }

    fn announced(&mut self, names: &Names, extensions: &[&str]) -> Result<(), Error> {
        if self.lock_feet && !extensions.contains(&BVH) {
            return Err(Error::usage(
                "`--lock-feet`, but this run draws no bodies: nothing was drawn",
                "leave it out: it is for runs that write BVH files, of recipe gmd_motion",
            ));
        }
        if self.existing == Existing::Replaced {
            return Ok(());
        }
        let stem = Path::new(&self.stem);
        let (Some(start), Some(folder)) = (stem.file_name(), stem.parent()) else {
            return Ok(());
        };
        let start = start.to_string_lossy();
        let folder = match folder.as_os_str().is_empty() {
            true => Path::new("."),
            false => folder,
        };
        // Names may be a billion: what is there is compared with them, not they with what is there.
        let mut taken: Vec<String> = fs::read_dir(folder)
            .into_iter()
            .flatten()
            .flatten()
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .filter(|file| {
                let extensions = extensions.iter().chain([&RECORD]);
                let rest = file.strip_prefix(&*start);
                extensions
                    .filter_map(|extension| rest?.strip_suffix(extension))
                    .any(|name| names.contains(name))
            })
            .collect();
        taken.sort();
        let Some(first) = taken.first().map(|file| stem.with_file_name(file)) else {
            return Ok(());
        };
        let exist = match taken.len() {
            1 => "exists".to_string(),
            all => format!("and {} more of its files exist", all - 1),
        };
        Err(Error::usage(
            format!("{} {exist} already: nothing was drawn", first.display()),
            "`--overwrite` replaces what is there; or choose another `--out`",
        ))
    }

    fn drawn(&mut self, drawn: Drawn) -> Result<(), Error> {
        if let Some(bar) = self.bar.take() {
            bar.finish();
        }
        must_be_finite(&drawn, &self.stem)?;
        let files = interrupt::not_during(|| self.write(&drawn))?;
        self.written += 1;
        let written = Written {
            files,
            record: drawn.record,
        };
        (self.tell)(&written);
        if self.keeps {
            self.kept.push(written);
        }
        Ok(())
    }

    fn note(&mut self, text: &str) {
        tell!("{text}");
    }

    fn warning(&mut self, text: &str) {
        tell!("warning: {text}");
    }
}
