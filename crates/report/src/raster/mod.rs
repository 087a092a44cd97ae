//! Still pictures of a scene, from a small software renderer with equal results on every machine.

mod camera;
mod canvas;
mod floor;
mod label;
mod object;
mod painter;
mod palette;

pub(crate) use canvas::Image;
pub(crate) use painter::{Painter, square_side};
pub(crate) use palette::PALETTE;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::palette::{LEFT, RIGHT};
    use crate::scene::Scene;
    use crate::scene::tests::{body, dancer};

    fn picture(scene: &Scene, seconds: f64, size: (u32, u32)) -> Image {
        Painter::new(scene, size).at(seconds)
    }

    /// Bounding box `[left, top, right, bottom]` of the pixels of a color.
    fn extent(image: &Image, colour: [u8; 3]) -> Option<[u32; 4]> {
        let mut found: Option<[u32; 4]> = None;
        for (index, pixel) in image.rgb.chunks_exact(3).enumerate() {
            if pixel == colour {
                let (x, y) = (index as u32 % image.width, index as u32 / image.width);
                let [l, t, r, b] = found.unwrap_or([x, y, x, y]);
                found = Some([l.min(x), t.min(y), r.max(x), b.max(y)]);
            }
        }
        found
    }

    fn scene(objects: Vec<crate::scene::SceneObject>) -> Scene {
        Scene {
            title: "test".into(),
            objects,
            ..Scene::default()
        }
    }

    #[test]
    fn a_body_is_seen_whole_and_its_left_side_is_where_it_belongs() {
        let picture = picture(&scene(vec![body(40)]), 0.0, (300, 200));
        assert_eq!((picture.width, picture.height), (300, 200));
        // Seen from the front, the left side is to the right.
        let left = extent(&picture, LEFT).expect("the left leg is drawn");
        let right = extent(&picture, RIGHT).expect("the right leg is drawn");
        assert!(
            left[0] + left[2] > right[0] + right[2],
            "{left:?} {right:?}"
        );
        let edge = |x: u32, y: u32| {
            let at = 3 * (y * 300 + x) as usize;
            [LEFT, RIGHT].contains(&picture.rgb[at..at + 3].try_into().unwrap())
        };
        assert!((0..300).all(|x| !edge(x, 0) && !edge(x, 199)));
        // The walking body fills a good part of the height.
        let high = left[3].max(right[3]) - left[1].min(right[1]);
        assert!(high > 40, "{high}");
    }

    #[test]
    fn only_moving_objects_change_the_picture() {
        let still = scene(vec![body(1)]);
        let moving = scene(vec![body(40)]);
        let size = (160, 120);
        assert!(picture(&still, 0.0, size) == picture(&still, 1.0, size));
        assert!(picture(&moving, 0.0, size) != picture(&moving, 1.0, size));
    }

    #[test]
    fn a_phrase_shows_its_facing() {
        let size = (200, 200);
        let front = picture(&scene(vec![dancer(1, 0.0)]), 0.0, size);
        let back = picture(&scene(vec![dancer(1, std::f32::consts::PI)]), 0.0, size);
        assert!(front.rgb.chunks(3).any(|p| p == palette::NOSE));
        let seen = |image: &Image| image.rgb.chunks(3).filter(|p| *p == palette::NOSE).count();
        assert!(
            seen(&front) > seen(&back),
            "{} {}",
            seen(&front),
            seen(&back)
        );
    }

    #[test]
    fn objects_stand_beside_one_another() {
        let two = picture(&scene(vec![body(10), body(10)]), 0.0, (400, 150));
        let left = extent(&two, LEFT).unwrap();
        assert!(left[0] < 200 && left[2] > 200, "{left:?}");
    }

    #[test]
    fn goals_lie_on_the_floor() {
        let mut with = scene(vec![body(40)]);
        with.floor.path = vec![[0.0, 0.0], [1.0, 1.0]];
        with.floor.keyframes = vec![(10, [0.5, 0.5])];
        with.floor.obstacles = vec![([-0.8, 0.4], 0.3)];
        let image = picture(&with, 0.0, (300, 200));
        for colour in [palette::PATH, palette::KEYFRAME, palette::OBSTACLE] {
            assert!(extent(&image, colour).is_some(), "{colour:?}");
        }
    }

    #[test]
    fn a_long_trajectory_is_followed() {
        let mut far = body(200);
        for frame in far.positions.chunks_exact_mut(12).enumerate() {
            for joint in frame.1.chunks_exact_mut(3) {
                joint[2] += 0.2 * frame.0 as f32;
            }
        }
        let far = scene(vec![far]);
        for seconds in [0.0, 5.0, 9.9] {
            let image = picture(&far, seconds, (200, 200));
            let [_, top, _, bottom] = extent(&image, LEFT).expect("the body is in the picture");
            assert!(bottom - top > 25, "{seconds}: {top} {bottom}");
        }
    }

    #[test]
    fn pictures_are_png_files() {
        let image = picture(&scene(vec![body(2)]), 0.0, (64, 48));
        let decoder = png::Decoder::new(std::io::Cursor::new(image.png()));
        let mut reader = decoder.read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        assert!(pixels == image.rgb);
    }

    #[test]
    fn odd_scenes_draw_something() {
        for objects in [vec![], vec![crate::scene::SceneObject::default()]] {
            let image = picture(&scene(objects), 1.0, (32, 32));
            assert_eq!(image.rgb.len(), 3 * 32 * 32);
        }
        let mut broken = body(3);
        broken.positions[4] = f32::NAN;
        broken.positions[14] = f32::INFINITY;
        broken.positions[20] = 1e30;
        picture(&scene(vec![broken]), 0.1, (32, 32));
    }
}
