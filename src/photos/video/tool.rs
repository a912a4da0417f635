//! FFmpeg's programs, run beside tid3r: no shell between, nothing asked of the user, whatever they write read
//! within bounds.

use crate::{Error, Result};
use std::{
    ffi::{OsStr, OsString},
    io::{self, BufRead, BufReader, Read},
    path::Path,
    process::{Child, ChildStdout, Command, Stdio},
    thread::JoinHandle,
};

/// As much of a line of messages as is kept.
const LINE_BYTES: u64 = 4096;

/// A program of FFmpeg that is running; ended when dropped.
pub(super) struct Tool {
    name: &'static str,
    child: Child,
    /// What it writes.
    pub(super) output: BufReader<ChildStdout>,
    messages: Option<JoinHandle<String>>,
}

impl Tool {
    /// Starts `ffmpeg` or `ffprobe` on a video. `before` stands before the input, `after` behind it. Each line of
    /// messages goes to `heard`, which says whether it is one that users need not see.
    ///
    /// # Errors
    /// When the program is not there or cannot be started.
    pub(super) fn start(
        name: &'static str,
        video: &Path,
        before: &[&str],
        after: &[&str],
        mut heard: impl FnMut(&str) -> bool + Send + 'static,
    ) -> Result<Self> {
        // A name may begin like an option, or like the address of something on a network.
        let absolute = std::path::absolute(video).map_err(Error::io("find", video))?;
        let mut input = OsString::from("file:");
        input.push(absolute);
        let mut child = Command::new(name)
            .args(before)
            .args(["-protocol_whitelist", "file"].map(OsStr::new))
            .args([OsStr::new("-i"), &input])
            .args(after)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| not_started(name, &error))?;
        let (Some(output), Some(errors)) = (child.stdout.take(), child.stderr.take()) else {
            return Err(not_started(name, &io::ErrorKind::BrokenPipe.into()));
        };
        let messages = std::thread::spawn(move || {
            let mut errors = BufReader::new(errors);
            let (mut line, mut last) = (Vec::new(), String::new());
            while (&mut errors)
                .take(LINE_BYTES)
                .read_until(b'\n', &mut line)
                .is_ok_and(|bytes| bytes > 0)
            {
                let text = String::from_utf8_lossy(&line).trim().to_string();
                line.clear();
                if !heard(&text) && !text.is_empty() {
                    last = text;
                }
            }
            last
        });
        Ok(Self {
            name,
            child,
            output: BufReader::new(output),
            messages: Some(messages),
        })
    }

    /// All that it writes, at most `limit` bytes.
    ///
    /// # Errors
    /// When it writes more, or as [`Tool::finish`].
    pub(super) fn whole_output(mut self, limit: u64, video: &Path) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let read = (&mut self.output).take(limit + 1).read_to_end(&mut bytes);
        read.map_err(Error::io("read", video))?;
        if bytes.len() as u64 > limit {
            return Err(failed(self.name, video, "it gives too much"));
        }
        self.finish(video)?;
        Ok(bytes)
    }

    /// Waits for the program, whose output has been read to its end.
    ///
    /// # Errors
    /// When it failed: with the last thing that it said.
    pub(super) fn finish(mut self, video: &Path) -> Result<()> {
        let status = self.child.wait().map_err(Error::io("read", video))?;
        let said = self.messages.take().and_then(|thread| thread.join().ok());
        let said = said
            .filter(|said| !said.is_empty())
            .unwrap_or_else(|| status.to_string());
        match status.success() {
            true => Ok(()),
            false => Err(failed(self.name, video, &said)),
        }
    }
}

impl Drop for Tool {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The error about a video that a program cannot read, or of which it says what makes no sense.
pub(super) fn failed(name: &str, video: &Path, problem: &str) -> Error {
    Error::file(
        video,
        format!("is no video that {name} can read ({problem})"),
        "check that it plays, or convert it to MP4",
    )
}

fn not_started(name: &str, error: &io::Error) -> Error {
    let problem = match error.kind() {
        io::ErrorKind::NotFound => {
            format!("there is no `{name}` on the PATH, by which videos are read")
        }
        _ => format!("`{name}`, by which videos are read, cannot be started: {error}"),
    };
    Error::request(
        problem,
        "install FFmpeg (`apt install ffmpeg`, `brew install ffmpeg`, `winget install ffmpeg`), or give photos",
    )
}
