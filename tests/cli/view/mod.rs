//! The server of `tid3r view`, spoken to as browsers do, and as they do not.

mod edits;
mod hostile;
mod renders;
mod serving;
mod start;
mod uploads;

use crate::{Place, place::PROGRAM};
use serde_json::Value;
use std::{
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    process::{Child, Command, Stdio},
    time::Duration,
};

/// A running server.
struct Server {
    process: Child,
    port: u16,
    /// The page's address but for the host.
    address: String,
}

/// What came back.
struct Answer {
    status: u16,
    head: String,
    body: Vec<u8>,
}

impl Server {
    /// About what is in `scene`.
    fn start(place: &Place, arguments: &str) -> Self {
        let arguments = ["view", "scene", "--port", "0"]
            .into_iter()
            .chain(arguments.split_whitespace());
        Self::start_with(place, &arguments.collect::<Vec<_>>())
    }

    fn start_with(place: &Place, arguments: &[&str]) -> Self {
        // Programs of the place come before those of the system.
        let system = std::env::var("PATH").unwrap_or_default();
        let programs = format!("{}:{system}", place.path("bin").display());
        let mut process = Command::new(PROGRAM)
            .args(arguments)
            .current_dir(place.folder())
            .env_remove("RUST_LOG")
            .env("PATH", programs)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let out = process.stdout.take().unwrap();
        BufReader::new(out).read_line(&mut line).unwrap();
        let (host, address) = line.trim()["http://".len()..].split_once('/').unwrap();
        Self {
            process,
            port: host.rsplit_once(':').unwrap().1.parse().unwrap(),
            address: format!("/{address}"),
        }
    }

    fn host(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    /// Sends a file as the page does.
    fn upload(&self, name: &str, content: &[u8]) -> Answer {
        let mut request = self.upload_head(name, content.len());
        request.extend(content);
        self.raw(&request)
    }

    /// What comes before a file of so many bytes; `name` as it stands in addresses.
    fn upload_head(&self, name: &str, bytes: usize) -> Vec<u8> {
        let (host, kind) = (self.host(), "application/octet-stream");
        format!(
            "POST /api/uploads/{name} HTTP/1.1\r\nConnection: close\r\nHost: {host}\r\nContent-Type: {kind}\r\n\
             Content-Length: {bytes}\r\n\r\n"
        )
        .into()
    }

    /// Sends bytes as they are.
    fn raw(&self, request: &[u8]) -> Answer {
        let mut stream = TcpStream::connect(self.host()).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(120)))
            .unwrap();
        // A server that refuses early may not read all.
        let _ = stream.write_all(request);
        let mut bytes = Vec::new();
        let _ = stream.read_to_end(&mut bytes);
        let end = bytes
            .windows(4)
            .position(|four| four == b"\r\n\r\n")
            .unwrap();
        let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
        Answer {
            status: head[9..12].parse().unwrap(),
            head: head.to_lowercase(),
            body: bytes[end + 4..].to_vec(),
        }
    }

    fn ask(&self, method: &str, path: &str, headers: &[&str], body: &str) -> Answer {
        let mut request = format!("{method} {path} HTTP/1.1\r\nConnection: close\r\n");
        if !headers.iter().any(|header| header.starts_with("Host:")) {
            request += &format!("Host: {}\r\n", self.host());
        }
        for header in headers {
            request += &format!("{header}\r\n");
        }
        request += &format!("Content-Length: {}\r\n\r\n{body}", body.len());
        self.raw(request.as_bytes())
    }

    fn get(&self, path: &str) -> Answer {
        self.ask("GET", path, &[], "")
    }

    fn send(&self, path: &str, content: &Value) -> Answer {
        let json = "Content-Type: application/json";
        self.ask("POST", path, &[json], &content.to_string())
    }

    fn scene(&self) -> Value {
        self.get("/api/scene").json()
    }

    /// The ids of the instances that there are.
    fn ids(&self) -> Vec<u64> {
        let scene = self.scene();
        let instances = scene["instances"].as_array().unwrap().iter();
        instances.map(|one| one["id"].as_u64().unwrap()).collect()
    }

    /// Waits until a job has ended, listening to news as the page does.
    fn ended(&self, id: u64) -> Value {
        let mut stream = TcpStream::connect(self.host()).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(300)))
            .unwrap();
        let request = format!("GET /api/events HTTP/1.1\r\nHost: {}\r\n\r\n", self.host());
        stream.write_all(request.as_bytes()).unwrap();
        for line in BufReader::new(stream).lines() {
            let line = line.unwrap();
            let Some(data) = line.strip_prefix("data: ") else {
                continue;
            };
            let jobs: Value = serde_json::from_str(data).unwrap();
            let jobs = jobs.as_array().unwrap();
            let job = jobs.iter().find(|job| job["id"] == id).unwrap();
            if !["queued", "running"].contains(&job["state"].as_str().unwrap()) {
                return job.clone();
            }
        }
        panic!("the server ended");
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Answer {
    fn json(&self) -> Value {
        assert_eq!(self.status, 200, "{}", String::from_utf8_lossy(&self.body));
        serde_json::from_slice(&self.body).unwrap()
    }

    /// Has to be a refusal with problem and remedy, and nothing that only a success has.
    fn assert_refused(&self, status: u16, problem: &str) {
        let text = String::from_utf8_lossy(&self.body);
        assert_eq!(self.status, status, "{text}");
        let said: Value = serde_json::from_slice(&self.body).unwrap();
        assert!(
            said["problem"].as_str().unwrap().contains(problem),
            "{text}"
        );
        assert!(!said["remedy"].as_str().unwrap().is_empty(), "{text}");
        assert!(
            self.head
                .contains("content-security-policy: default-src 'none'")
        );
    }
}
