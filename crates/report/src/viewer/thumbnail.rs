//! Small viewers, from scenes or from existing pages.

use serde_json::{Value, json};

use super::{DATA, element, scene_json};
use crate::scene::Scene;

/// A small viewer of one or several objects, without curves or song. The motion loops while
/// visible.
#[derive(Clone, Debug)]
pub struct Thumbnail {
    title: String,
    data: Value,
}

impl From<Scene> for Thumbnail {
    fn from(scene: Scene) -> Self {
        Self {
            data: scene_json(&scene, true),
            title: scene.title,
        }
    }
}

impl Thumbnail {
    /// A thumbnail of each object in a [page](super::page); empty for other text.
    pub fn of_page(page: &str) -> Vec<Self> {
        let data = || {
            let [begin, end] = DATA;
            let (_, data) = page.split_once(begin)?;
            let (data, _) = data.split_once(end)?;
            serde_json::from_str::<Value>(data).ok()
        };
        let Some(mut scene) = data() else {
            return Vec::new();
        };
        let objects = scene.get_mut("figures").and_then(Value::as_array_mut);
        let objects = objects.map(std::mem::take);
        let floor = scene.get_mut("floor").map(Value::take);
        let thumbnails = objects.unwrap_or_default().into_iter();
        let thumbnails = thumbnails.filter(Value::is_object).map(|mut object| {
            let title = object["name"].as_str().unwrap_or_default().to_owned();
            // Small viewers omit these fields.
            let frames = object["frames"].as_u64().unwrap_or_default() as usize;
            object["charts"] = json!([]);
            object["curves"] = super::encode::curves(&[], frames);
            Self {
                data: json!({ "title": title, "figures": [object], "floor": floor, "song": null }),
                title,
            }
        });
        thumbnails.collect()
    }

    /// An element of a page with [`style`](super::style) and [`script`](super::script).
    pub fn html(&self) -> String {
        element(&self.title, &self.data, "kg kg-small")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneObject;
    use crate::scene::tests::{body, dancer};
    use crate::viewer::page;

    #[test]
    fn a_page_gives_the_thumbnails_of_its_objects() {
        let objects = [body(12), dancer(20, 0.5)];
        let scene = |objects: &[SceneObject]| Scene {
            title: objects[0].name.clone(),
            objects: objects.to_vec(),
            ..Scene::default()
        };
        let found = Thumbnail::of_page(&page(&scene(&objects)));
        let found: Vec<String> = found.iter().map(Thumbnail::html).collect();
        let each = objects.map(|object| Thumbnail::from(scene(&[object])).html());
        assert_eq!(found, each);
    }

    #[test]
    fn other_text_gives_none_and_nothing_becomes_markup() {
        for page in ["", "<p>", "<script type=\"application/json\">{</script>"] {
            assert!(Thumbnail::of_page(page).is_empty());
        }
        let [begin, end] = DATA;
        let odd = "{\"figures\": [{\"name\": \"\\u003c/script>\"}, 3]}";
        for thumbnail in Thumbnail::of_page(&format!("{begin}{odd}{end}")) {
            let html = thumbnail.html();
            assert_eq!(html.matches(end).count(), 1, "{html}");
        }
    }
}
