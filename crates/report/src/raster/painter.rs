//! Draws a scene at many times.

use super::camera::{Camera, middle};
use super::canvas::Image;
use super::palette::BACKGROUND;
use super::{floor, label, object};
use crate::scene::{Floor, Scene, SceneObject, bounds};

/// Largest motion of a camera at rest, in meters.
const AT_REST: f32 = 6.0;
/// Half width of the smoothing of a following camera, seconds.
const SMOOTHING: f64 = 0.4;
/// Maximum number of points of a drawn root trajectory.
const TRAIL_POINTS: usize = 600;
/// Maximum number of frames for measuring the size of a motion.
const MEASURED: usize = 300;
/// Reach of a lone root along each axis, in meters.
const LONE_REACH: f32 = 0.35;
/// Number of objects in one row; more objects form a square.
const ROW: u32 = 3;
/// Smallest side of a picture, in pixels.
const SMALLEST: u32 = 16;

/// Side of the smallest square of at least `count` cells.
pub(crate) fn square_side(count: u32) -> u32 {
    let mut sides = 1..;
    let side = sides.find(|side| side * side >= count);
    side.expect("there is one")
}

/// A scene with its cameras.
pub(crate) struct Painter<'a> {
    scene: &'a Scene,
    size: (u32, u32),
    columns: u32,
    cell: (u32, u32),
    views: Vec<View<'a>>,
}

/// An object with its camera.
struct View<'a> {
    object: &'a SceneObject,
    camera: Camera,
    /// Target of the unmoved camera on the ground.
    middle: [f32; 2],
    trail: Vec<[f32; 2]>,
    /// The ground, if the camera is at rest.
    ground: Option<Image>,
}

impl<'a> Painter<'a> {
    /// Prepares pictures of `size` pixels.
    pub fn new(scene: &'a Scene, (width, height): (u32, u32)) -> Self {
        let objects: Vec<&SceneObject> = scene.objects.iter().filter(|f| f.frames() > 0).collect();
        let count = objects.len().max(1) as u32;
        let columns = match count {
            ..=ROW => count,
            _ => square_side(count),
        };
        let rows = count.div_ceil(columns);
        let cell = (
            (width / columns).max(SMALLEST),
            (height / rows).max(SMALLEST),
        );
        let views = objects.into_iter();
        Self {
            scene,
            size: (width.max(columns * cell.0), height.max(rows * cell.1)),
            columns,
            cell,
            views: views
                .map(|object| View::new(object, &scene.floor, cell))
                .collect(),
        }
    }

    /// Size of each picture in pixels, with a minimum.
    pub fn size(&self) -> (u32, u32) {
        self.size
    }

    /// The scene at a time.
    pub fn at(&self, seconds: f64) -> Image {
        let mut image = Image::filled(self.size.0, self.size.1, BACKGROUND);
        for (index, view) in self.views.iter().enumerate() {
            let corner = (
                index as u32 % self.columns * self.cell.0,
                index as u32 / self.columns * self.cell.1,
            );
            image.paste(&view.at(seconds, &self.scene.floor, self.cell), corner);
            if self.views.len() > 1 {
                label::write(&mut image, &view.object.name, corner, self.cell.0);
            }
        }
        image
    }
}

impl<'a> View<'a> {
    fn new(object: &'a SceneObject, floor: &Floor, cell: (u32, u32)) -> Self {
        let step = object.frames().div_ceil(TRAIL_POINTS);
        let trail: Vec<[f32; 2]> = (0..object.frames())
            .step_by(step)
            .map(|frame| on_ground(object.joint(frame, 0)))
            .collect();
        let mut points = shown(object, floor);
        let [low, high] = bounds(&points);
        let rest = (high[0] - low[0]).max(high[2] - low[2]) <= AT_REST;
        if !rest {
            points = around_root(object);
        }
        let camera = Camera::around(&points, cell);
        let middle = on_ground(middle(&points));
        let mut view = Self {
            object,
            camera,
            middle,
            trail,
            ground: None,
        };
        if rest {
            view.ground = Some(view.ground(&camera, middle, floor, cell));
        }
        view
    }

    fn at(&self, seconds: f64, floor: &Floor, cell: (u32, u32)) -> Image {
        let mut camera = self.camera;
        let mut image = match &self.ground {
            Some(ground) => ground.clone(),
            None => {
                let [x, z] = self.followed(seconds);
                camera = camera.moved([x, 0.0, z]);
                let middle = [x + self.middle[0], z + self.middle[1]];
                self.ground(&camera, middle, floor, cell)
            }
        };
        let frame = self.object.frame_at(seconds);
        floor::draw_now(&mut image, &camera, floor, frame);
        let pose = self.object.pose(seconds);
        let contacts = self.object.contacts.iter();
        let standing: Vec<usize> = contacts
            .filter(|contact| contact.frames.get(frame) == Some(&true))
            .map(|contact| contact.joint)
            .filter(|joint| *joint < pose.joints.len())
            .collect();
        object::draw(&mut image, &camera, self.object, &pose, &standing);
        image
    }

    fn ground(
        &self,
        camera: &Camera,
        middle: [f32; 2],
        floor: &Floor,
        (width, height): (u32, u32),
    ) -> Image {
        let mut image = Image::filled(width, height, BACKGROUND);
        floor::draw(&mut image, camera, middle, floor, &self.trail);
        image
    }

    /// Ground position of the root, smoothed over time for the camera.
    fn followed(&self, seconds: f64) -> [f32; 2] {
        let places = (-4..=4).map(|step| {
            let moment = seconds + f64::from(step) / 4.0 * SMOOTHING;
            on_ground(self.object.pose(moment).joints[0])
        });
        places.fold([0.0; 2], |sum: [f32; 2], [x, z]| {
            [sum[0] + x / 9.0, sum[1] + z / 9.0]
        })
    }
}

fn on_ground([x, _, z]: [f32; 3]) -> [f32; 2] {
    [x, z]
}

/// Joint positions over the motion, including the reach of a lone root and the ground below the
/// root.
fn joints(object: &SceneObject) -> impl Iterator<Item = (usize, [f32; 3])> {
    let step = object.frames().div_ceil(MEASURED).max(1);
    let is_lone = object.joints() == 1;
    let reach = if is_lone { LONE_REACH } else { 0.0 };
    let frames = (0..object.frames()).step_by(step);
    let all = frames.flat_map(move |frame| {
        let [x, y, z] = object.joint(frame, 0);
        let own = (0..object.joints()).map(move |joint| object.joint(frame, joint));
        let around = [-reach, reach].map(|by| [x + by, y + by, z + by]);
        let places = own.chain(around).chain([[x, 0.0, z]]);
        places.map(move |place| (frame, place))
    });
    all.filter(|(_, place)| place.iter().all(|value| value.abs() < 1e6))
}

/// Points for a camera at rest: the motion and the goal.
fn shown(object: &SceneObject, floor: &Floor) -> Vec<[f32; 3]> {
    let keys = floor.keyframes.iter().map(|(_, at)| *at);
    let points = floor.path.iter().copied().chain(keys);
    let obstacles = floor
        .obstacles
        .iter()
        .flat_map(|([x, z], radius)| [[x - radius, z - radius], [x + radius, z + radius]]);
    let ground = points.chain(obstacles).map(|[x, z]| [x, 0.0, z]);
    let places = joints(object).map(|(_, place)| place);
    places.chain(ground).collect()
}

/// Points for a following camera: the body relative to its root, and some ground.
fn around_root(object: &SceneObject) -> Vec<[f32; 3]> {
    let body = joints(object).map(|(frame, [x, y, z])| {
        let [from_x, _, from_z] = object.joint(frame, 0);
        [x - from_x, y, z - from_z]
    });
    let ground = [[-0.6, 0.0, -0.6], [0.6, 0.0, 0.6]];
    body.chain(ground).collect()
}
