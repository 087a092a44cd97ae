//! Rotations as tensors with gradients.

use burn::tensor::Tensor;
use kinegrad_motion::phrase::FPS;

/// Added under the square root in the rotation's sine, because the square root's gradient at zero
/// is infinite.
const ROOT_EPS: f64 = 1e-12;

/// -1 where `x` is negative, else 1; unlike the sign, never 0. The gradient treats the value as a
/// constant.
pub fn hemisphere(x: Tensor<3>) -> Tensor<3> {
    x.lower_elem(0.0).float() * -2.0 + 1.0
}

/// Sine and cosine `[batch, 2, time]` of the sum of two angles.
pub(crate) fn add_angle(angle: Tensor<3>, sine: Tensor<3>, cosine: Tensor<3>) -> Tensor<3> {
    let [s, c] = [0, 1].map(|row| angle.clone().narrow(1, row, 1));
    let sin = s.clone() * cosine.clone() + c.clone() * sine.clone();
    Tensor::cat(vec![sin, c * cosine - s * sine], 1)
}

/// The products `a b` of quaternions, `[batch, 4, time]` each: the rotation `b`, then `a`.
pub fn product(a: Tensor<3>, b: Tensor<3>) -> Tensor<3> {
    let parts = |q: Tensor<3>| [0, 1, 2, 3].map(|index| q.clone().narrow(1, index, 1));
    let ([w1, x1, y1, z1], [w0, x0, y0, z0]) = (parts(a), parts(b));
    let of = |a: &Tensor<3>, b: &Tensor<3>| a.clone() * b.clone();
    let w = of(&w1, &w0) - of(&x1, &x0) - of(&y1, &y0) - of(&z1, &z0);
    let x = of(&x1, &w0) + of(&w1, &x0) + of(&y1, &z0) - of(&z1, &y0);
    let y = of(&y1, &w0) + of(&w1, &y0) + of(&z1, &x0) - of(&x1, &z0);
    let z = of(&z1, &w0) + of(&w1, &z0) + of(&x1, &y0) - of(&y1, &x0);
    Tensor::cat(vec![w, x, y, z], 1)
}

/// The inverse rotations of unit quaternions, `[batch, 4, time]`.
pub fn conjugate(q: Tensor<3>) -> Tensor<3> {
    Tensor::cat(vec![q.clone().narrow(1, 0, 1), -q.narrow(1, 1, 3)], 1)
}

/// The rotations of angular velocities over one frame, `exp(w / fps)`, as unit quaternions.
///
/// # Shapes
/// - rates: `[batch, 3, time]`, radians per second in the world frame
/// - output: `[batch, 4, time]`
pub fn step(rates: Tensor<3>) -> Tensor<3> {
    let half = rates / (2.0 * FPS);
    let angle = (half.clone().square().sum_dim(1) + ROOT_EPS).sqrt();
    let sine = half * (angle.clone().sin() / angle.clone());
    Tensor::cat(vec![angle.cos(), sine], 1)
}

/// The integrals of angular velocities, starting with the identity at the first frame: frame `t`
/// has the product of `exp(w[s] / fps)` over all earlier frames `s`. Unit quaternions.
///
/// # Shapes
/// - rates: `[batch, 3, time]`, radians per second in the world frame
/// - output: `[batch, 4, time]`
pub fn turned(rates: Tensor<3>) -> Tensor<3> {
    let [batch, _, time] = rates.dims();
    let steps = step(rates);
    let none = Tensor::cat(
        vec![
            steps.clone().slice([0..batch, 0..1, 0..1]).ones_like(),
            steps.clone().slice([0..batch, 1..4, 0..1]).zeros_like(),
        ],
        1,
    );
    let mut all = Tensor::cat(vec![none, steps], 2).narrow(2, 0, time);
    // Each iteration doubles the number of frames per product.
    let mut reach = 1;
    while reach < time {
        let before = all.clone().narrow(2, 0, time - reach);
        let longer = product(all.clone().narrow(2, reach, time - reach), before);
        all = Tensor::cat(vec![all.narrow(2, 0, reach), longer], 2);
        reach *= 2;
    }
    all
}

/// The rotation vector of `q[t+1] q[t]*` times fps, in the world frame, in radians per second, for
/// any signs and norms. Value and gradient are finite for equal and antipodal quaternions.
///
/// # Shapes
/// - q: `[batch, 4, time]`, at least two frames
/// - output: `[batch, 3, time - 1]`
pub fn angular_velocity(q: Tensor<3>) -> Tensor<3> {
    let time = q.dims()[2];
    let (now, next) = (q.clone().narrow(2, 0, time - 1), q.narrow(2, 1, time - 1));
    let turn = product(next, conjugate(now));
    let (w, vector) = (turn.clone().narrow(1, 0, 1), turn.narrow(1, 1, 3));

    // Chooses the sign of the quaternion with a rotation of at most half a turn.
    let sign = hemisphere(w.clone());
    let sine = (vector.clone().square().sum_dim(1) + ROOT_EPS).sqrt();
    let angle = sine.clone().atan2(w.abs()) * 2.0;
    vector * sign * (angle / sine) * FPS
}
