use super::*;

/// A queue, and a way to wait until a job has ended.
fn queue() -> (Queue, impl Fn(&Queue, u32) -> Job) {
    let (sender, receiver) = mpsc::channel();
    let sender = Mutex::new(sender);
    let queue = Queue::new(move || {
        let _ = lock(&sender).send(());
    });
    let ended = move |queue: &Queue, id: u32| loop {
        let job = queue.all().into_iter().find(|job| job.id == id).unwrap();
        if !matches!(job.state, State::Queued | State::Running) {
            return job;
        }
        receiver.recv_timeout(Duration::from_secs(60)).unwrap();
    };
    (queue.unwrap(), ended)
}

fn failing(problem: &'static str) -> Work {
    Box::new(move |_| Err(Error::request(problem, "do something else")))
}

#[test]
fn jobs_end_as_their_work_does() {
    let (queue, ended) = queue();
    queue
        .push(
            1,
            "good".into(),
            Box::new(|progress| {
                progress.note("a word");
                progress.begin("counting", 3);
                progress.advance(2);
                Ok(())
            }),
        )
        .unwrap();
    queue.push(2, "bad".into(), failing("no")).unwrap();
    queue
        .push(3, "panics".into(), Box::new(|_| panic!("on purpose")))
        .unwrap();
    queue
        .push(4, "after it".into(), Box::new(|_| Ok(())))
        .unwrap();
    let job = ended(&queue, 1);
    assert_eq!((job.state, job.done, job.total), (State::Done, 2, 3));
    assert_eq!(
        (&*job.task, &*job.notes),
        ("counting", &["a word".to_string()][..])
    );
    let job = ended(&queue, 2);
    assert_eq!(job.state, State::Failed);
    assert!(job.problem.unwrap().contains("do something else"));
    let job = ended(&queue, 3);
    assert_eq!(job.state, State::Failed);
    assert!(job.problem.unwrap().contains("report this"));
    assert_eq!(
        ended(&queue, 4).state,
        State::Done,
        "a panic stops no other"
    );
}

#[test]
fn jobs_can_be_cancelled_before_and_while_they_run() {
    let (queue, ended) = queue();
    let (sender, receiver) = mpsc::channel();
    queue
        .push(
            1,
            "endless".into(),
            Box::new(move |progress| {
                sender.send(()).unwrap();
                while !progress.is_cancelled() {
                    std::thread::yield_now();
                }
                Err(Error::Cancelled)
            }),
        )
        .unwrap();
    queue
        .push(2, "waits".into(), failing("never begins"))
        .unwrap();
    receiver.recv().unwrap();
    queue.cancel(2).unwrap();
    assert_eq!(ended(&queue, 2).state, State::Cancelled);
    queue.cancel(1).unwrap();
    assert_eq!(ended(&queue, 1).state, State::Cancelled);
    assert!(queue.cancel(1).is_err() && queue.cancel(9).is_err());
    queue.push(1, "again".into(), Box::new(|_| Ok(()))).unwrap();
    assert_eq!(ended(&queue, 1).state, State::Done);
    queue.forget(1);
    assert_eq!(queue.all().len(), 1);
}

#[test]
fn pictures_that_take_shape_are_shown_while_a_job_runs() {
    let (queue, ended) = queue();
    let (sender, receiver) = mpsc::channel();
    let (go_on, wait) = mpsc::channel();
    let work: Work = Box::new(move |progress| {
        for shade in [10, 20, 30] {
            for name in ["a", "b"] {
                let picture = RgbImage::from_pixel(1, 1, image::Rgb([shade; 3]));
                progress.preview(name, &|| Some(picture.clone()));
            }
            progress.preview("none", &|| None);
        }
        for name in ["c", "d", "e"] {
            progress.preview(name, &|| Some(RgbImage::new(1, 1)));
        }
        sender.send(()).unwrap();
        wait.recv().unwrap();
        Ok(())
    });
    queue.push(1, "draws".into(), work).unwrap();
    receiver.recv().unwrap();
    let previews = queue.all().remove(0).previews;
    let names: Vec<&str> = previews.iter().map(|preview| &*preview.name).collect();
    assert_eq!(names, ["b", "c", "d", "e"], "the latest four");
    assert_eq!(queue.preview(1, 0).unwrap().get_pixel(0, 0).0, [30; 3]);
    assert!(queue.preview(1, 4).is_none() && queue.preview(2, 0).is_none());
    go_on.send(()).unwrap();
    assert!(
        ended(&queue, 1).previews.is_empty(),
        "there are pictures now"
    );
}

#[test]
fn dropping_the_queue_ends_what_runs() {
    let (queue, _) = queue();
    let (sender, receiver) = mpsc::channel();
    queue
        .push(
            1,
            "endless".into(),
            Box::new(move |progress| {
                sender.send("begun").unwrap();
                while !progress.is_cancelled() {
                    std::thread::yield_now();
                }
                sender.send("ended").unwrap();
                Err(Error::Cancelled)
            }),
        )
        .unwrap();
    assert_eq!(receiver.recv(), Ok("begun"));
    drop(queue);
    assert_eq!(receiver.try_recv(), Ok("ended"));
}
