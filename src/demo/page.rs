//! One HTML page that shows the demo.

use super::{report::DemoReport, stage_set::StageSet};
use crate::{Result, scene::files};
use std::{fmt::Write, path::Path};

const STYLE: &str = "
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2rem auto; padding: 0 1rem; }
h1, h2 { line-height: 1.2; }
figure { margin: 0; }
figcaption { font-size: 0.85rem; opacity: 0.75; }
img { width: 100%; height: auto; border-radius: 4px; display: block; }
.row { display: grid; grid-template-columns: repeat(auto-fit, minmax(220px, 1fr)); gap: 0.75rem; margin: 0.75rem 0; }
table { border-collapse: collapse; }
td, th { padding: 0.15rem 1rem 0.15rem 0; text-align: right; font-variant-numeric: tabular-nums; }
td:first-child, th:first-child { text-align: left; }
th { padding-top: 0.8rem; border-bottom: 1px solid; }
";

/// Writes `index.html`, which shows the pictures in `folder`.
pub(super) fn write(folder: &Path, set: &StageSet, report: &DemoReport) -> Result<()> {
    let mut page = String::new();
    // Writing to a string does not fail.
    let _ = compose(&mut page, set, report);
    files::write_atomically(&folder.join("index.html"), |out| {
        out.write_all(page.as_bytes())
    })
}

fn compose(page: &mut String, set: &StageSet, report: &DemoReport) -> std::fmt::Result {
    let object = &report.showcase;
    write!(
        page,
        "<!doctype html>\n<html lang=\"en\">\n<head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width\">\
         <title>tid3r: room {seed}</title><style>{STYLE}</style></head>\n<body>\n\
         <h1>Room {seed}</h1>\n\
         <p>{inputs} photos of a procedural room, seen by networks that make mistakes, became a cloud \
         of separate objects (<a href=\"scene/points.ply\">points.ply</a>). The {object} was removed, moved and recoloured, and the room \
         rendered from places where no photo was taken.</p>\n",
        seed = report.seed,
        inputs = set.inputs.len(),
    )?;
    table(page, report)?;
    section(page, "Photos", "What the method was given.")?;
    let photos = set
        .inputs
        .iter()
        .map(|shot| (format!("photos/{}.png", shot.name), String::new()));
    figures(page, photos)?;
    section(
        page,
        "Instances",
        "Every object that was found, with its id; and the room from above.",
    )?;
    let overviews = [
        ("scene/contact_sheet.png", "contact sheet"),
        ("scene/top_down.png", "plan"),
    ];
    figures(
        page,
        overviews.map(|(file, caption)| (file.into(), caption.into())),
    )?;
    section(
        page,
        "Novel views",
        &format!(
            "The cloud as projected, completed by {}, and the true picture.",
            report.completed_by
        ),
    )?;
    for shot in &set.held_out {
        let name = &shot.name;
        figures(
            page,
            [
                (
                    format!("pictures/novel_views/{name}.projection.png"),
                    "projected".into(),
                ),
                (
                    format!("pictures/novel_views/{name}.png"),
                    "completed".into(),
                ),
                (format!("test_photos/{name}.png"), "truth".into()),
            ],
        )?;
    }
    let without = object.replace(' ', "_");
    section(
        page,
        &format!("Without the {object}"),
        "Before, after, after with photos that still show the object, and the truth.",
    )?;
    for shot in &set.held_out {
        let name = &shot.name;
        if !shot.view.instances.values().contains(&set.showcase.id) {
            continue;
        }
        figures(
            page,
            [
                (format!("pictures/novel_views/{name}.png"), "before".into()),
                (
                    format!("pictures/removed/{name}.png"),
                    "removed, references masked".into(),
                ),
                (
                    format!("pictures/removed_unmasked/{name}.png"),
                    "removed, references as they are".into(),
                ),
                (
                    format!("truth/test_photos_without_{without}/{name}.png"),
                    "truth".into(),
                ),
            ],
        )?;
    }
    section(page, &format!("The {object}, moved and recoloured"), "")?;
    for shot in &set.held_out {
        let name = &shot.name;
        figures(
            page,
            [
                (format!("pictures/novel_views/{name}.png"), "before".into()),
                (format!("pictures/moved/{name}.png"), "moved".into()),
                (
                    format!("pictures/recoloured/{name}.png"),
                    "recoloured".into(),
                ),
            ],
        )?;
    }
    writeln!(page, "</body>\n</html>")
}

fn section(page: &mut String, title: &str, text: &str) -> std::fmt::Result {
    writeln!(page, "<h2>{title}</h2>\n<p>{text}</p>")
}

fn figures(
    page: &mut String,
    pictures: impl IntoIterator<Item = (String, String)>,
) -> std::fmt::Result {
    writeln!(page, "<div class=\"row\">")?;
    for (file, caption) in pictures {
        writeln!(
            page,
            "<figure><a href=\"{file}\"><img loading=\"lazy\" src=\"{file}\" alt=\"{caption}\"></a>\
             <figcaption>{caption}</figcaption></figure>"
        )?;
    }
    writeln!(page, "</div>")
}

fn table(page: &mut String, report: &DemoReport) -> std::fmt::Result {
    writeln!(page, "<table>")?;
    for row in report.rows() {
        // Rows without figures are headings.
        let heading = row[2].chars().all(|c| !c.is_ascii_digit());
        let tag = if heading { "th" } else { "td" };
        let [what, before, after] = row.map(|cell| cell.replace('<', "&lt;"));
        writeln!(
            page,
            "<tr><{tag}>{what}</{tag}><{tag}>{before}</{tag}><{tag}>{after}</{tag}></tr>"
        )?;
    }
    writeln!(page, "</table>")
}
