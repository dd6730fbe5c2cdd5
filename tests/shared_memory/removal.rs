//! Files that are removed while in use, as systemd does at logout.

use std::path::PathBuf;
use std::thread;
use std::time::{Duration, Instant};

use iceoryx2::prelude::*;
use overcam::output::shared_memory::{PublishError, Publisher};
use scene::Scene;

use crate::{PATIENCE, Process, exists, full_name, node, sequence_of, unique};

/// The files by which new subscribers find a service: those on disk, and those in shared memory.
fn files_of(service: &str) -> [Vec<PathBuf>; 2] {
    let (name, config) = (full_name(service), Config::default());
    let node = node();
    let scenes = node.service_builder(&name).publish_subscribe::<Scene>();
    let scenes = scenes.open().expect("it is published");
    let wakeups = node.service_builder(&name).event().open();
    let wakeups = wakeups.expect("it is published");
    let numbers = [
        scenes.unique_service_id().value(),
        wakeups.unique_service_id().value(),
    ]
    .map(|number| format!("_{number}.dynamic"));
    let entries = std::fs::read_dir("/dev/shm").expect("there is shared memory");
    let in_memory = entries
        .map(|entry| entry.expect("it is listed").path())
        .filter(|path| {
            let path = path.to_string_lossy();
            numbers.iter().any(|number| path.ends_with(number))
        });
    let on_disk = [MessagingPattern::PublishSubscribe, MessagingPattern::Event]
        .map(|pattern| scene::static_file(&config, &name, pattern));
    [on_disk.to_vec(), in_memory.collect()]
}

#[test]
fn removed_files_are_noticed_and_published_again() {
    for (case, which) in [&[0, 1][..], &[0], &[1]].into_iter().enumerate() {
        let service = unique(&format!("removed-{case}"));
        let mut publisher = Publisher::open(&service).expect("the service is free");
        let mut scene = Scene::EMPTY;
        let before = Process::with_role("watch", &service);
        before.next_sequence(&mut publisher, &mut scene);
        let files = files_of(&service);
        assert_eq!(files.each_ref().map(Vec::len), [2, 2]);
        for file in which.iter().flat_map(|&which| &files[which]) {
            std::fs::remove_file(file).expect("it was there");
        }

        let deadline = Instant::now() + PATIENCE;
        let said = loop {
            match publisher.send(&scene) {
                Ok(()) => {}
                Err(error) => break error,
            }
            assert!(Instant::now() < deadline, "it is never noticed");
            thread::sleep(Duration::from_millis(20));
        };
        match which {
            // Nobody notices.
            [0] => assert!(matches!(said, PublishError::PutBack { .. }), "{said}"),
            _ => assert!(matches!(said, PublishError::Removed { .. }), "{said}"),
        }
        assert!(!said.to_string().contains('\n'));
        scene.sequence = 1_000_000;
        let deadline = Instant::now() + PATIENCE;
        let watchers = [before, Process::with_role("watch", &service)];
        for watcher in &watchers {
            loop {
                assert!(Instant::now() < deadline, "case {case}: it is never found");
                let _ = publisher.send(&scene);
                scene.sequence += 1;
                let line = watcher.poll_line(Duration::from_millis(20));
                if line.is_some_and(|line| sequence_of(&line) >= 1_000_000) {
                    break;
                }
            }
        }
        for watcher in watchers {
            assert_eq!(watcher.end().0, Some(0));
        }
        drop(publisher);
        assert!(!exists(&service), "something was left behind");
    }
}
