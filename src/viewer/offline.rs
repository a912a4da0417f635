//! The page as one file that needs no server: to look at, not to edit.

use super::{assets::ASSETS, description::Description, photo::jpeg, session::Snapshot};
use crate::{
    Error, Result,
    scene::{Scene, files},
};
use base64::{Engine, engine::general_purpose::STANDARD};
use serde_json::{Value, json};
use std::path::Path;

/// The file loads nothing, from nowhere.
const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline' data:; style-src 'unsafe-inline'; \
    img-src data: blob:; base-uri 'none'; form-action 'none'";

/// Writes a scene, as edits left it, with the page into one HTML file; says what is in it.
///
/// # Errors
/// When the scene cannot be read or the file not be written.
pub(crate) fn write(scene: &Scene, path: &Path) -> Result<String> {
    let snapshot = Snapshot::read(Scene::open(scene.folder())?)?;
    let photos = snapshot.shown.edited.photos.iter();
    let photos = photos
        .map(|photo| Ok(data_url("image/jpeg", &jpeg(photo)?)))
        .collect::<Result<Vec<_>>>()?;
    let mut description = serde_json::to_value(Description::new(&snapshot)).map_err(|error| {
        let problem = format!("the scene cannot be described ({error})");
        Error::request(problem, "report this as a defect")
    })?;
    // Where it was made is nobody's business.
    description["folder"] = Value::Null;
    description["not_editable"] = "This is a copy to look at.".into();
    let (before, after) = shell();
    files::write_atomically(path, |file| {
        file.write_all(before.as_bytes())?;
        let kept = json!({ "scene": description, "photos": photos });
        let kept = kept.to_string().replace('<', "\\u003c");
        write!(
            file,
            "<script type=\"application/json\" id=\"kept\">{kept}</script>"
        )?;
        let chunks = (0..).map_while(|number| snapshot.points().chunk(number));
        for chunk in chunks {
            let text = STANDARD.encode(chunk);
            write!(
                file,
                "\n<script type=\"text/plain\" class=\"cloud\">{text}</script>"
            )?;
        }
        file.write_all(after.as_bytes())
    })?;
    Ok(format!(
        "{} points and {} photos",
        snapshot.points().len(),
        photos.len()
    ))
}

fn data_url(kind: &str, bytes: &[u8]) -> String {
    format!("data:{kind};base64,{}", STANDARD.encode(bytes))
}

fn asset(name: &str) -> &'static str {
    let found = ASSETS.iter().find(|(known, _)| *known == name);
    found.map_or("", |(_, text)| text)
}

/// The page with all its files in it, before and after what is in the scene.
fn shell() -> (String, String) {
    // Modules within the file have no addresses of their own: they go by bare names.
    let scripts = ASSETS.iter().filter(|(name, _)| name.ends_with(".js"));
    let modules: serde_json::Map<String, Value> = scripts
        .map(|(name, text)| {
            let bare = text.replace("from \"./", "from \"page/");
            let url = data_url("text/javascript", bare.as_bytes());
            (format!("page/{name}"), url.into())
        })
        .collect();
    let page = asset("index.html")
        .replace(
            "<meta charset=\"utf-8\">",
            &format!("<meta charset=\"utf-8\">\n  <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">"),
        )
        .replace("<body>", "<body data-offline>")
        .replace("/assets/icon.svg", &data_url("image/svg+xml", asset("icon.svg").as_bytes()))
        .replace(
            "<link rel=\"stylesheet\" href=\"/assets/style.css\">",
            &format!("<style>{}</style>", asset("style.css")),
        )
        .replace(
            "<script type=\"module\" src=\"/assets/app.js\"></script>",
            &format!(
                "<script type=\"importmap\">{}</script>\n  <script type=\"module\">import \"page/app.js\";</script>",
                json!({ "imports": modules })
            ),
        );
    let (before, after) = page.split_once("</body>").unwrap_or((&page, ""));
    (before.to_string(), format!("\n</body>{after}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_refers_to_nothing_outside() {
        let (before, after) = shell();
        let page = before + &after;
        assert!(!page.contains("/assets/") && page.contains("<body data-offline>"));
        assert!(page.contains("page/app.js") && page.contains("Content-Security-Policy"));
        for (name, text) in ASSETS.iter().filter(|(name, _)| name.ends_with(".js")) {
            let imports = text.lines().filter(|line| line.starts_with("import "));
            for import in imports {
                let from = import
                    .split("from \"./")
                    .nth(1)
                    .and_then(|rest| rest.split('"').next());
                assert!(
                    from.is_some_and(|file| !asset(file).is_empty()),
                    "{name}: {import}"
                );
            }
        }
        assert!(page.ends_with("</html>\n"));
    }
}
