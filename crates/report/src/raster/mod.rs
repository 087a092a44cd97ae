//! Still pictures of a scene, from a small software renderer with equal results on every machine. It
//! draws what the viewer's `draw.js` draws, from the same numbers.

mod canvas;
mod figure;
mod floor;
mod painter;
mod root;

pub(crate) use canvas::Image;
pub(crate) use painter::Painter;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::{Color, DRAWING, WHITE};
    use crate::scene::tests::{body, dancer};
    use crate::scene::{Scene, SceneObject};

    fn picture(scene: &Scene, seconds: f64, size: (u32, u32)) -> Image {
        Painter::new(scene, size, 1.0).at(seconds)
    }

    /// Places of the pixels within `off` of a color in each channel.
    fn found(image: &Image, Color(color): Color, off: u8) -> Vec<[u32; 2]> {
        let pixels = image.rgb.chunks_exact(3).enumerate();
        let is_near = |pixel: &[u8]| pixel.iter().zip(color).all(|(a, b)| a.abs_diff(b) <= off);
        let own = pixels.filter(|(_, pixel)| is_near(pixel));
        own.map(|(at, _)| [at as u32 % image.width, at as u32 / image.width])
            .collect()
    }

    /// Bounding box `[left, top, right, bottom]` of the pixels of a color below the label.
    fn extent(image: &Image, color: Color) -> [u32; 4] {
        let places = found(image, color, 2);
        let places = || places.iter().filter(|[_, y]| *y > 24);
        let [left, top] = [0, 1].map(|axis| places().map(|at| at[axis]).min().expect("seen"));
        let [right, bottom] = [0, 1].map(|axis| places().map(|at| at[axis]).max().expect("seen"));
        [left, top, right, bottom]
    }

    /// Colors of the left and the right side of a figure.
    fn sides(figure: usize) -> [Color; 2] {
        let color = DRAWING.color_of(figure);
        let table = &DRAWING.bone;
        [
            color.mixed(WHITE, table.left_lighter),
            color.mixed(Color([0; 3]), table.right_darker),
        ]
    }

    fn scene(objects: Vec<SceneObject>) -> Scene {
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
        let [left, right] = sides(0).map(|color| extent(&picture, color));
        assert!(
            left[0] + left[2] > right[0] + right[2],
            "{left:?} {right:?}"
        );
        let all = [left, right];
        assert!(
            all.iter()
                .all(|[l, t, r, b]| *l > 5 && *t > 5 && *r < 295 && *b < 195)
        );
        // The head is a ball above the body.
        let head = extent(&picture, DRAWING.color_of(0));
        assert!(head[1] < left[1] && head[2] - head[0] > 5, "{head:?}");
        assert!(left[3].max(right[3]) - head[1] > 60, "{left:?} {head:?}");
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
        let arrow = |yaw: f32| {
            let image = picture(&scene(vec![dancer(1, yaw)]), 0.0, size);
            let is_gold = |p: &&[u8]| p[0] > 200 && p[2] < 100 && p[1] > 120;
            image.rgb.chunks_exact(3).filter(is_gold).count()
        };
        let [front, back] = [0.0, std::f32::consts::PI].map(arrow);
        assert!(back > 20 && front > back, "{front} {back}");
    }

    #[test]
    fn objects_stand_beside_one_another_at_one_scale() {
        let mut tall = body(10);
        for value in &mut tall.positions {
            *value *= 2.0;
        }
        let two = picture(&scene(vec![body(10), tall]), 0.0, (400, 200));
        let [small, large] = [0, 1].map(|figure| extent(&two, DRAWING.color_of(figure)));
        assert!(small[2] < 200 && large[0] > 200, "{small:?} {large:?}");
        let height = |[_, top, _, bottom]: [u32; 4]| f64::from(bottom - top);
        let ratio = height(large) / height(small);
        assert!((1.7..2.3).contains(&ratio), "{ratio}");
    }

    #[test]
    fn goals_lie_on_the_floor() {
        let mut with = scene(vec![body(40)]);
        with.floor.path = vec![[0.0, 0.0], [1.0, 1.0]];
        with.floor.keyframes = vec![(10, [0.5, 0.5])];
        with.floor.obstacles = vec![([-0.8, 0.4], 0.3)];
        let image = picture(&with, 0.0, (300, 200));
        for color in [DRAWING.light.goal, DRAWING.light.obstacle] {
            assert!(!found(&image, color, 20).is_empty(), "{color:?}");
        }
    }

    #[test]
    fn a_long_trajectory_is_followed() {
        let mut far = body(200);
        for (frame, row) in far.positions.chunks_exact_mut(12).enumerate() {
            for joint in row.chunks_exact_mut(3) {
                joint[2] += 0.2 * frame as f32;
            }
        }
        let far = scene(vec![far]);
        for seconds in [0.0, 5.0, 9.9] {
            let image = picture(&far, seconds, (200, 200));
            let [_, top, _, bottom] = extent(&image, sides(0)[0]);
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
        let mut huge = body(3);
        huge.positions[20] = 1e30;
        for objects in [vec![], vec![SceneObject::default()], vec![huge]] {
            let image = picture(&scene(objects), 1.0, (32, 32));
            assert_eq!(image.rgb.len(), 3 * 32 * 32);
        }
    }
}
