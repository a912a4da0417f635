use super::*;

#[test]
fn the_length_is_the_streams_or_else_the_files() {
    let said = |text: &str| length(text.as_bytes());
    let both = r#"{"streams": [{"duration": "2.500000"}], "format": {"duration": "9.0"}}"#;
    assert_eq!(said(both), Ok(Some(2_500_000)));
    let format = r#"{"programs": [], "streams": [{}], "format": {"duration": "9.0"}}"#;
    assert_eq!(said(format), Ok(Some(9_000_000)));
    for unknown in ["N/A", "-1", "nan", "inf", "1e300"] {
        let text = format!(r#"{{"streams": [{{"duration": "{unknown}"}}], "format": {{}}}}"#);
        assert_eq!(said(&text), Ok(None), "{unknown}");
    }
    assert!(said(r#"{"streams": [], "format": {"duration": "9.0"}}"#).is_err());
    assert!(said("{}").is_err() && said("").is_err() && said("\u{1}garbage").is_err());
}

#[test]
fn times_are_read_from_lines_about_frames_only() {
    let line =
        "[Parsed_showinfo_4 @ 0x5581] n:   3 pts: 300033 pts_time:0.300033 duration: 0 fmt:gray";
    assert_eq!(moment(line), Some(Moment(300_033)));
    let early = "[Parsed_showinfo_4 @ 0x5581] n:   0 pts: -33333 pts_time:-0.033 fmt:gray";
    assert_eq!(moment(early), Some(Moment(0)));
    for other in [
        "[Parsed_showinfo_4 @ 0x5581] config in time_base: 1/1000000, frame_rate: 30/1",
        "[Parsed_showinfo_4 @ 0x5581] n:   3 pts: NOPTS pts_time:NOPTS",
        "[Parsed_showinfo_4 @ 0x5581] n:   3 pts:",
        "[h264 @ 0x5581] n: 3 pts: 12",
        "",
    ] {
        assert_eq!(moment(other), None, "{other}");
    }
}

#[test]
fn frames_are_called_by_their_time() {
    let called = |microseconds| {
        Moment(microseconds)
            .called("walk")
            .to_str()
            .unwrap()
            .to_string()
    };
    assert_eq!(called(12_345_678), "walk_00m12s345.jpg");
    assert_eq!(called(0), "walk_00m00s000.jpg");
    assert_eq!(called(3_600_000_000 + 59_999_999), "walk_60m59s999.jpg");
}

#[test]
fn long_videos_are_looked_at_less_often_and_short_ones_more() {
    let seconds = |seconds: u64| Some(seconds * 1_000_000);
    assert_eq!(step(seconds(60), 16), CLOSEST);
    assert_eq!(step(seconds(7200), 16), 2_400_000);
    // 2 s: 128 frames for 16.
    assert_eq!(step(seconds(2), 16), 15_625);
    assert_eq!(step(None, 16), CLOSEST);
    assert!(step(Some(1), 1000) > 0);
}

#[test]
fn grey_frames_are_whole_or_refused() {
    let bytes = |frames: usize, more: usize| vec![9; frames * GREY_SIDE * GREY_SIDE + more];
    let values = |bytes: Vec<u8>| sharpnesses(&mut &*bytes, || {});
    assert_eq!(values(bytes(3, 0)).unwrap(), [0.0; 3]);
    assert!(values(bytes(0, 0)).unwrap().is_empty());
    assert!(values(bytes(2, 5)).is_err());
}

#[test]
fn counts_are_read_within_their_limits() {
    assert_eq!(parse_count("16"), Ok(16));
    for text in ["0", "1001", "-1", "many", ""] {
        assert!(parse_count(text).is_err(), "{text}");
    }
}
