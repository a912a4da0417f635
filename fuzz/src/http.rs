//! The server of `tid3r view` in this process, and a client of it.

use crate::heard;
use std::{
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    path::PathBuf,
    sync::mpsc,
    time::Duration,
};
use tid3r::viewer::{Address, Options, serve};

/// Whoever does not answer for so long hangs.
const PATIENCE: Duration = Duration::from_secs(15);

/// A server of the page, and a connection to it.
pub struct Client {
    host: String,
    connection: Option<BufReader<TcpStream>>,
}

/// What was answered.
#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    pub body: Vec<u8>,
}

impl Client {
    /// Serves the page about what is at `scene`.
    ///
    /// # Panics
    /// When it cannot be served.
    pub fn of(scene: PathBuf) -> Self {
        let (sender, receiver) = mpsc::channel();
        std::thread::spawn(move || {
            let ready = |url: &str| sender.send(url.to_string()).expect("somebody waits");
            serve(&scene, Options::default(), &Address::default(), ready)
                .expect("the page can be served");
        });
        let url = receiver.recv().expect("the page is served");
        let host = url.trim_start_matches("http://").trim_end_matches('/');
        Self {
            host: host.to_string(),
            connection: None,
        }
    }

    /// What the server answers; nothing where it takes the request for none and hangs up.
    ///
    /// # Panics
    /// When it does not answer at all.
    pub fn ask(&mut self, method: &str, path: &str, kind: &str, body: &[u8]) -> Option<Answer> {
        let head = format!(
            "{method} {path} HTTP/1.1\r\nHost: {}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\n\r\n",
            self.host,
            body.len()
        );
        let request = [head.as_bytes(), body].concat();
        // A connection that was kept may be closed, of which a client learns only then.
        let kept = self.connection.take().and_then(|kept| sent(kept, &request));
        let (mut connection, head) = match kept {
            Some(answered) => answered,
            None => sent(self.connected(), &request)?,
        };
        let (status, length, goes_on) = head;
        let length = match method {
            "HEAD" => Some(0),
            _ => length,
        };
        // What has no length is the stream of events, which has no end.
        let mut body = vec![0; length.unwrap_or(0)];
        connection.read_exact(&mut body).ok()?;
        if goes_on && length.is_some() {
            self.connection = Some(connection);
        }
        if status >= 400 {
            let said = String::from_utf8_lossy(&body);
            heard::<(), _>(Err(format!("{method} {path}: {status} {said}")));
        }
        Some(Answer { status, body })
    }

    fn connected(&self) -> BufReader<TcpStream> {
        let stream = TcpStream::connect(&self.host).expect("the server listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a timeout");
        stream.set_nodelay(true).expect("a socket");
        BufReader::new(stream)
    }
}

/// Status, length of the body if it is stated, whether the connection stays.
type Head = (u16, Option<usize>, bool);

/// The connection after a request, and how the answer begins.
fn sent(mut to: BufReader<TcpStream>, request: &[u8]) -> Option<(BufReader<TcpStream>, Head)> {
    // Whoever refuses a request need not read all of it.
    let _ = to.get_mut().write_all(request);
    let head = read_head(&mut to)?;
    Some((to, head))
}

fn read_head(connection: &mut BufReader<TcpStream>) -> Option<Head> {
    let line = read_line(connection)?;
    let status = line.split(' ').nth(1)?.parse().ok()?;
    let (mut length, mut goes_on) = (None, true);
    loop {
        let line = read_line(connection)?.to_ascii_lowercase();
        match line.split_once(':') {
            Some(("content-length", value)) => length = value.trim().parse().ok(),
            Some(("connection", value)) => goes_on = value.trim() != "close",
            Some(_) => {}
            None if matches!(status, 204 | 304) => return Some((status, Some(0), goes_on)),
            None => return Some((status, length, goes_on)),
        }
    }
}

/// A line without its end; nothing where the connection was closed.
fn read_line(connection: &mut BufReader<TcpStream>) -> Option<String> {
    let mut line = Vec::new();
    match connection.read_until(b'\n', &mut line) {
        Ok(0) => None,
        Ok(_) => Some(String::from_utf8_lossy(&line).trim_end().to_string()),
        Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {
            panic!("there is no answer")
        }
        Err(_) => None,
    }
}
