//! Files of samples.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use kinegrad_output::path_text;
use kinegrad_train::Error;
use kinegrad_train::sampling::{Contents, Names, Record, Sample, SampleSink};
use serde::Serialize;

use super::bvh::{bvh_file, bvh_text};
use super::outputs::{Content, stem, with_ending, write_all};
use super::unusable::UNUSABLE;
use crate::interrupt;
use crate::progress::Denoising;

/// Extension of a sample's record.
const RECORD: &str = ".json";

/// A sample that was written.
#[derive(Serialize)]
pub struct Written {
    /// The files, the motion first and the record last.
    #[serde(serialize_with = "path_text")]
    pub files: Vec<PathBuf>,
    /// Its record.
    pub record: Record,
}

/// Writes samples and their records to files with one stem.
#[derive(Default)]
pub struct Files {
    stem: OsString,
    overwrite: bool,
    bar: Option<Denoising>,
    /// Prints neither files nor notes; warnings are printed.
    is_silent: bool,
    /// Gives all samples their usual names.
    pub(crate) allows_unusable: bool,
    /// Number of samples that are [not usable](Record::is_usable).
    pub(crate) unusable: usize,
    /// Collects the samples in `collected` instead of printing their files.
    pub(crate) collects: bool,
    pub(crate) collected: Vec<Written>,
    /// Locks the feet in BVH files.
    pub(crate) lock_feet: bool,
    /// The motions that were written.
    pub(crate) motions: Vec<PathBuf>,
}

impl Files {
    /// Files with the prefix `out`; each is printed.
    ///
    /// # Errors
    /// If `out` names a folder.
    pub fn new(out: &Path, overwrite: bool) -> Result<Self, Error> {
        Ok(Self {
            stem: stem(out)?,
            overwrite,
            ..Self::default()
        })
    }

    /// Files in `folder` that are not printed.
    pub(crate) fn silent(folder: &Path) -> Self {
        Self {
            // With a separator at its end.
            stem: folder.join("").into_os_string(),
            overwrite: true,
            is_silent: true,
            allows_unusable: true,
            ..Self::default()
        }
    }

    fn path(&self, name: &str, extension: &str) -> PathBuf {
        with_ending(&self.stem, &format!("{name}{extension}"))
    }

    /// The file of a sample's motion.
    pub fn motion_path(&self, sample: &Sample) -> PathBuf {
        let extension = sample.files.first().map_or("", |(extension, _)| extension);
        self.path(&sample.name, extension)
    }

    /// Writes all files of a sample, and returns their paths: the motion first, the record last. A
    /// failure removes written files.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, sample: &Sample) -> Result<Vec<PathBuf>, Error> {
        let mut files = Vec::with_capacity(sample.files.len() + 1);
        for (extension, contents) in &sample.files {
            let path = self.path(&sample.name, extension);
            let content = self.content(&path, contents)?;
            files.push((path, content));
        }
        let record = serde_json::to_string_pretty(&sample.record).expect("plain data") + "\n";
        files.push((self.path(&sample.name, RECORD), Content::Text(record)));
        write_all(&files)?;
        Ok(files.into_iter().map(|(path, _)| path).collect())
    }

    fn content<'a>(&self, path: &Path, contents: &'a Contents) -> Result<Content<'a>, Error> {
        Ok(match contents {
            Contents::Array { shape, values } => Content::Array {
                shape: shape.clone(),
                values,
            },
            Contents::Body { joints, skeleton } => Content::Text(match self.is_silent {
                true => bvh_text(joints, skeleton)?,
                false => bvh_file(path, joints, skeleton, self.lock_feet)?.to_text(),
            }),
        })
    }
}

/// Rejects a sample that is not finite; `stem` is the prefix of its file names.
///
/// # Errors
/// For a number that is not finite; names the first file.
pub fn must_be_finite(sample: &Sample, stem: &str) -> Result<(), Error> {
    for (extension, contents) in &sample.files {
        if let Contents::Array { values, .. } = contents
            && !values.iter().all(|value| value.is_finite())
        {
            let sample = format!("{stem}{}{extension}", sample.name);
            return Err(Error::SampleNotFinite { sample });
        }
    }
    Ok(())
}

/// Extension of BVH files.
const BVH: &str = ".bvh";

impl SampleSink for Files {
    fn stepped(&mut self, stage: &'static str, done: usize, all: usize) {
        let bar = self.bar.get_or_insert_with(|| Denoising::of(""));
        bar.show(stage, done, all);
    }

    fn reserve_outputs(&mut self, names: &Names, extensions: &[&str]) -> Result<(), Error> {
        if self.lock_feet && !extensions.contains(&BVH) {
            return Err(Error::usage(
                "`--lock-feet`, but this run generates no bodies",
                "leave it out: it is for runs that write BVH files, such as those of recipe gmd_motion",
            ));
        }
        if self.overwrite {
            return Ok(());
        }
        let stem = Path::new(&self.stem);
        let (Some(start), Some(folder)) = (stem.file_name(), stem.parent()) else {
            return Ok(());
        };
        let start = start.to_string_lossy();
        let is_here = folder.as_os_str().is_empty();
        let folder = if is_here { Path::new(".") } else { folder };
        // A billion names are possible, so existing files are compared with the names.
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        let files = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
        let is_taken = |file: &String| {
            let rest = file.strip_prefix(&*start);
            let mut extensions = extensions.iter().chain([&RECORD]);
            extensions.any(|extension| {
                let name = rest.and_then(|rest| rest.strip_suffix(extension));
                let usual = name.map(|name| name.strip_suffix(UNUSABLE).unwrap_or(name));
                usual.is_some_and(|name| names.contains(name))
            })
        };
        let mut taken: Vec<String> = files.filter(is_taken).collect();
        taken.sort();
        let Some(first) = taken.first().map(|file| stem.with_file_name(file)) else {
            return Ok(());
        };
        let exist = match taken.len() {
            1 => "exists".to_string(),
            all => format!("and {} more of its files exist", all - 1),
        };
        Err(Error::usage(
            format!("{} {exist} already: nothing was sampled", first.display()),
            "replace them with `--overwrite`, or choose another `--out`",
        ))
    }

    fn sample(&mut self, mut sample: Sample) -> Result<(), Error> {
        if let Some(bar) = self.bar.take() {
            bar.finish();
        }
        must_be_finite(&sample, &self.stem.to_string_lossy())?;
        if !self.allows_unusable && !sample.record.is_usable() {
            sample.name += UNUSABLE;
            self.unusable += 1;
        }
        let files = interrupt::not_during(|| self.write(&sample))?;
        self.motions.extend(files.first().cloned());
        let written = Written {
            files,
            record: sample.record,
        };
        if self.collects {
            self.collected.push(written);
        } else if !self.is_silent {
            for file in &written.files {
                say!("{}", file.display());
            }
        }
        Ok(())
    }

    fn note(&mut self, text: &str) {
        if !self.is_silent {
            tell!("{text}");
        }
    }

    fn warning(&mut self, text: &str) {
        tell!("warning: {text}");
    }
}
