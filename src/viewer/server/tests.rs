use super::*;
use crate::viewer::jobs::make::MAKING;
use std::{
    io::{Read, Write},
    net::TcpStream,
    sync::mpsc,
    time::Instant,
};

/// What the server answers.
fn get(host: &str, path: &str) -> String {
    let mut stream = TcpStream::connect(host).unwrap();
    write!(
        stream,
        "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
    )
    .unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn a_job_that_panics_leaves_the_server_up() {
    let place = tempfile::tempdir().unwrap();
    let shared = shared(&place.path().join("scene"), Options::default());
    let shared = Arc::new(shared.unwrap());
    let (sender, receiver) = mpsc::channel();
    let of_server = Arc::clone(&shared);
    let server = std::thread::spawn(move || {
        let ready = |url: &str| sender.send(url.to_string()).unwrap();
        runtime()?.block_on(run(&of_server, &Address::default(), ready))
    });
    let url = receiver.recv().unwrap();
    let host = url.trim_start_matches("http://").trim_end_matches('/');

    let push = |work| shared.queue.push(MAKING, "The scene".into(), work).unwrap();
    let ended = || {
        let begin = Instant::now();
        while shared.queue.is_going_on(MAKING) {
            assert!(begin.elapsed() < Duration::from_secs(60));
            std::thread::yield_now();
        }
        shared.queue.all().remove(0).problem
    };
    push(Box::new(|_| panic!("on purpose")));
    assert!(ended().unwrap().contains("report this"));
    assert!(get(host, "/").starts_with("HTTP/1.1 200"));
    assert!(get(host, "/api/start").contains("\"uploads\":[]"));
    push(Box::new(|_| Ok(())));
    assert_eq!(ended(), None, "the next one runs");

    shared.ending.send_replace(true);
    server.join().unwrap().unwrap();
}
