//! MP4 videos with the song, through `ffmpeg`.

use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use kinegrad_output::Unfinished;

use crate::encoder::{self, Encoder};
use crate::export::{self, ExportError, Stop};
use crate::raster::Painter;
use crate::scene::{Scene, Song};

/// The program.
const ENCODER: &str = "ffmpeg";
/// Pictures per second.
const FPS: u32 = 30;
/// Pixels of a video relative to a GIF, along each side.
const SCALE: u32 = 2;
/// Time without progress after which ffmpeg is ended.
const PATIENCE: Duration = Duration::from_secs(60);
/// Number of ffmpeg's lines in an error.
const LAST_LINES: usize = 4;

/// Writes a scene as an MP4 file (H.264, and AAC with a song) through the `ffmpeg` on the PATH.
/// Silence follows a song that is shorter than the motion. `stop` is called before each picture.
///
/// # Errors
/// The errors of [`must_be_exportable`](crate::must_be_exportable); [`ExportError::TooLong`];
/// [`ExportError::NoEncoder`] without ffmpeg; [`ExportError::Encoder`] if ffmpeg fails; [`ExportError::Write`];
/// [`ExportError::Interrupted`] once `stop` returns true.
pub fn write(scene: &Scene, out: &Path, stop: Stop<'_>) -> Result<(), ExportError> {
    write_by(OsStr::new(ENCODER), PATIENCE, scene, out, stop)
}

/// Checks that ffmpeg is on the PATH and answers.
///
/// # Errors
/// [`ExportError::NoEncoder`].
pub fn must_have_encoder(out: &Path) -> Result<(), ExportError> {
    must_answer(OsStr::new(ENCODER), PATIENCE, out)
}

fn must_answer(program: &OsStr, patience: Duration, out: &Path) -> Result<(), ExportError> {
    let missing = |reason| no_encoder(out, program, &reason);
    let mut command = Command::new(program);
    command
        .arg("-version")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    let mut child = command.spawn().map_err(missing)?;
    let answered = encoder::wait(&mut child, patience, out, || false);
    answered.map(drop).map_err(missing)
}

fn no_encoder(out: &Path, program: &OsStr, reason: &std::io::Error) -> ExportError {
    ExportError::NoEncoder {
        out: out.to_path_buf(),
        program: program.display().to_string(),
        reason: reason.to_string(),
    }
}

/// [`write`] through another program with the same arguments.
fn write_by(
    program: &OsStr,
    patience: Duration,
    scene: &Scene,
    out: &Path,
    stop: Stop<'_>,
) -> Result<(), ExportError> {
    export::check(scene, out)?;
    export::check_pictures(scene, pictures(scene), out)?;
    let film = Unfinished::new(out).map_err(ExportError::write(out))?;
    let music = scene.song.as_ref().map(|song| {
        let file = Unfinished::with(out, &song.bytes).map_err(ExportError::write(out))?;
        Ok::<_, ExportError>((song, file))
    });
    let music = music.transpose()?;
    let song = music.as_ref().map(|(song, file)| (*song, file.path()));
    encode((program, patience), scene, song, film.path(), out, stop)?;
    film.finish().map_err(ExportError::write(out))
}

/// Number of pictures of a scene.
fn pictures(scene: &Scene) -> usize {
    ((scene.seconds() * f64::from(FPS)).round() as usize).max(1)
}

fn encode(
    (program, patience): (&OsStr, Duration),
    scene: &Scene,
    song: Option<(&Song, &Path)>,
    film: &Path,
    out: &Path,
    stop: Stop<'_>,
) -> Result<(), ExportError> {
    let (width, height) = crate::gif::size(scene);
    let size = (SCALE * width, SCALE * height);
    let painter = Painter::new(scene, size, f64::from(SCALE));
    let count = pictures(scene);
    let seconds = count as f64 / f64::from(FPS);
    let mut command = Command::new(program);
    command
        .args(arguments(size, seconds, song, film))
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    // Ctrl-C reaches only this process, and this process ends ffmpeg.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    let child = command.spawn();
    let child = child.map_err(|reason| no_encoder(out, program, &reason))?;
    let encoder = Encoder::new(child, patience);
    let are_offered = (0..count).all(|picture| {
        let image = painter.at(picture as f64 / f64::from(FPS));
        !stop(picture, count) && encoder.take(image.rgb, || stop(picture, count))
    });
    let (status, messages, are_taken) = encoder.finish(film, || stop(count, count));
    let taken = are_offered && are_taken;
    if stop(count, count) {
        return Err(ExportError::Interrupted {
            out: out.to_path_buf(),
        });
    }
    let status = match status {
        // A program that closes its input early reports the reason on exit.
        Ok(status) if status.success() && taken && is_written(film) => return Ok(()),
        Ok(status) => status.to_string(),
        Err(reason) => reason.to_string(),
    };
    Err(ExportError::Encoder {
        out: out.to_path_buf(),
        status,
        last_lines: last_lines(&messages),
    })
}

/// True for a regular file that is not empty.
fn is_written(film: &Path) -> bool {
    std::fs::symlink_metadata(film).is_ok_and(|film| film.is_file() && film.len() > 0)
}

fn arguments(
    (width, height): (u32, u32),
    seconds: f64,
    song: Option<(&Song, &Path)>,
    film: &Path,
) -> Vec<OsString> {
    // A name with a colon is not a URL.
    let file = |path: &Path| {
        let mut name = OsString::from("file:");
        name.push(path);
        name
    };
    let words = |text: &str| -> Vec<OsString> { text.split(' ').map(OsString::from).collect() };
    let mut all = words(&format!(
        "-hide_banner -loglevel error -nostdin -y -f rawvideo -pix_fmt rgb24 -s {width}x{height} \
         -framerate {FPS} -i pipe:0"
    ));
    if let Some((song, path)) = song {
        // Without a format, ffmpeg would also read a song as a list of other files.
        let (start, demuxer) = (song.start.max(0.0), song.format.demuxer());
        all.extend(words(&format!("-ss {start:.6} -f {demuxer} -i")));
        all.push(file(path));
        all.extend(words("-map 0:v:0 -map 1:a:0 -af apad -c:a aac -b:a 160k"));
    }
    // The song is padded and cut to the length of the motion.
    all.extend(words(&format!(
        "-t {seconds:.6} -c:v libx264 -crf 20 -pix_fmt yuv420p -movflags +faststart -f mp4"
    )));
    all.push(file(film));
    all
}

fn last_lines(messages: &str) -> String {
    let lines = messages.lines().filter(|line| !line.trim().is_empty());
    let lines: Vec<&str> = lines.collect();
    let last = &lines[lines.len().saturating_sub(LAST_LINES)..];
    if last.is_empty() {
        return "no messages".into();
    }
    last.join("; ")
}

#[cfg(all(test, unix))]
mod tests {
    use std::fs;
    use std::os::unix::fs::PermissionsExt;
    use std::path::PathBuf;

    use super::*;
    use crate::scene::SongFormat;
    use crate::scene::tests::{body, dancer};

    /// A program that replaces ffmpeg.
    fn stand_in(folder: &Path, script: &str) -> PathBuf {
        let path = folder.join("encoder");
        fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        path
    }

    fn scene(song: bool) -> Scene {
        Scene {
            objects: vec![body(20)],
            song: song.then(|| Song {
                format: SongFormat::Mp3,
                bytes: b"a song".to_vec(),
                start: 12.5,
                beats: vec![],
            }),
            ..Scene::default()
        }
    }

    fn files(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn the_encoder_gets_all_pictures_and_the_song() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("dance.mp4");
        // Writes its arguments, the song and the size of the pictures to its last argument.
        let script = "for last; do\ncase $last in file:*) song=${other#file:}; other=$last;; esac\n\
                      done\n{ echo \"$@\"; [ -z \"$song\" ] || cat \"$song\"; echo; wc -c; } \
                      > \"${last#file:}\"";
        let program = stand_in(folder.path(), script);
        write_by(
            program.as_os_str(),
            PATIENCE,
            &scene(true),
            &out,
            &|_, _| false,
        )
        .unwrap();
        assert_eq!(files(folder.path()), ["dance.mp4", "encoder"]);
        let log = fs::read_to_string(&out).unwrap();
        let lines: Vec<&str> = log.lines().collect();
        assert!(
            lines[0].contains("-s 800x720 -framerate 30 -i pipe:0 -ss 12.500000 -f mp3 -i file:")
        );
        assert!(lines[0].contains("-t 1.000000") && lines[0].contains("-pix_fmt yuv420p"));
        assert_eq!(lines[1], "a song");
        assert_eq!(lines[2].trim(), (30 * 3 * 800 * 720).to_string());
        write_by(
            program.as_os_str(),
            PATIENCE,
            &scene(false),
            &out,
            &|_, _| false,
        )
        .unwrap_or_else(|e| panic!("{e}"));
        assert!(!fs::read_to_string(&out).unwrap().contains("-ss"));
    }

    #[test]
    fn pictures_without_end_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("dance.mp4");
        let mut slow = scene(true);
        slow.objects[0].fps = 1e-6;
        let program = stand_in(folder.path(), "cat > /dev/null");
        let error =
            write_by(program.as_os_str(), PATIENCE, &slow, &out, &|_, _| false).unwrap_err();
        assert!(error.to_string().contains("at most 2592000"), "{error}");
        assert_eq!(files(folder.path()), ["encoder"]);
    }

    #[test]
    fn an_encoder_that_fails_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("dance.mp4");
        fs::write(&out, "an older film").unwrap();
        for (script, messages) in [
            // Leaves an incomplete file and unread pictures.
            (
                "for last; do :; done\necho half > \"${last#file:}\"\necho Unknown encoder >&2\nexit 8",
                "Unknown encoder",
            ),
            ("cat > /dev/null", "no messages"),
            (
                "for last; do :; done\ncat > /dev/null\nln -sf encoder \"${last#file:}\"",
                "no messages",
            ),
        ] {
            let program = stand_in(folder.path(), script);
            let error = write_by(
                program.as_os_str(),
                PATIENCE,
                &scene(true),
                &out,
                &|_, _| false,
            )
            .unwrap_err();
            assert!(matches!(error, ExportError::Encoder { .. }), "{error}");
            assert!(error.to_string().contains(messages), "{error}");
            assert_eq!(files(folder.path()), ["dance.mp4", "encoder"]);
        }
        let error = write_by(
            OsStr::new("no-such-encoder"),
            PATIENCE,
            &scene(true),
            &out,
            &|_, _| false,
        )
        .unwrap_err();
        assert!(
            error
                .to_string()
                .contains("`no-such-encoder` cannot be started")
        );
        assert_eq!(files(folder.path()), ["dance.mp4", "encoder"]);
        assert_eq!(fs::read_to_string(&out).unwrap(), "an older film");
    }

    #[test]
    fn stopping_leaves_no_file_and_no_encoder() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("dance.mp4");
        // Reads all pictures and continues for a minute.
        let script =
            "for last; do :; done\necho half > \"${last#file:}\"\ncat > /dev/null\nexec sleep 60";
        let program = stand_in(folder.path(), script);
        let asked = std::cell::Cell::new(0);
        let stop = |_: usize, _: usize| {
            asked.set(asked.get() + 1);
            asked.get() > 5
        };
        let began = std::time::Instant::now();
        let error = write_by(program.as_os_str(), PATIENCE, &scene(true), &out, &stop).unwrap_err();
        assert!(matches!(error, ExportError::Interrupted { .. }), "{error}");
        assert!(began.elapsed().as_secs() < 30);
        assert_eq!(files(folder.path()), ["encoder"]);
    }

    #[test]
    fn an_encoder_that_hangs_or_floods_is_ended() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("dance.mp4");
        let patience = Duration::from_millis(300);
        let began = std::time::Instant::now();
        for script in [
            "exec sleep 60",
            "cat > /dev/null; exec sleep 60",
            "exec yes >&2",
            "sleep 60 & exit 1",
        ] {
            let program = stand_in(folder.path(), script);
            let program = program.as_os_str();
            let error = write_by(program, patience, &scene(false), &out, &|_, _| false);
            let error = error.unwrap_err();
            assert!(matches!(error, ExportError::Encoder { .. }), "{error}");
            assert!(error.to_string().len() < 20_000, "{script}");
            assert_eq!(files(folder.path()), ["encoder"], "{script}");
        }
        let program = stand_in(folder.path(), "exec sleep 60");
        let error = must_answer(program.as_os_str(), patience, &out).unwrap_err();
        assert!(error.to_string().contains("did nothing"), "{error}");
        assert!(began.elapsed().as_secs() < 30);
    }

    #[test]
    fn sizes_are_even() {
        for count in 1..20 {
            let scene = Scene {
                objects: vec![dancer(1, 0.0); count],
                ..Scene::default()
            };
            let (width, height) = crate::gif::size(&scene);
            let even = [width, height]
                .iter()
                .all(|side| (SCALE * side).is_multiple_of(2));
            assert!(even, "{count}: {width} x {height}");
        }
    }
}
