//! Rotations as tensors with gradients.

use burn::tensor::Tensor;
use kinegrad_motion::phrase::FPS;

/// Added under the root of the rotation's sine, whose gradient at zero is infinite.
const ROOT_EPS: f64 = 1e-12;

/// -1 where `x` is negative, else 1; a constant to the gradient. Unlike the sign, never 0.
pub fn hemisphere(x: Tensor<3>) -> Tensor<3> {
    x.lower_elem(0.0).float() * -2.0 + 1.0
}

/// The rotation vector of `q[t+1] q[t]*` times fps, in the world frame, whatever the signs and
/// norms, in radians per second. Finite and with a finite gradient for equal and for antipodal
/// quaternions.
///
/// # Shapes
/// - q: `[batch, 4, time]`, at least two frames
/// - output: `[batch, 3, time - 1]`
pub fn angular_velocity(q: Tensor<3>) -> Tensor<3> {
    let time = q.dims()[2];
    let (now, next) = (q.clone().narrow(2, 0, time - 1), q.narrow(2, 1, time - 1));
    let c = |x: &Tensor<3>, index: usize| x.clone().narrow(1, index, 1);
    let [w0, x0, y0, z0] = [0, 1, 2, 3].map(|i| c(&now, i));
    let [w1, x1, y1, z1] = [0, 1, 2, 3].map(|i| c(&next, i));
    let product = |a: &Tensor<3>, b: &Tensor<3>| a.clone() * b.clone();
    let w = product(&w1, &w0) + product(&x1, &x0) + product(&y1, &y0) + product(&z1, &z0);
    let x = product(&x1, &w0) - product(&w1, &x0) - product(&y1, &z0) + product(&z1, &y0);
    let y = product(&y1, &w0) - product(&w1, &y0) - product(&z1, &x0) + product(&x1, &z0);
    let z = product(&z1, &w0) - product(&w1, &z0) - product(&x1, &y0) + product(&y1, &x0);
    let vector = Tensor::cat(vec![x, y, z], 1);

    // Of the two quaternions of a rotation, the one that turns by at most half a turn.
    let sign = hemisphere(w.clone());
    let sine = (vector.clone().square().sum_dim(1) + ROOT_EPS).sqrt();
    let angle = sine.clone().atan2(w.abs()) * 2.0;
    vector * sign * (angle / sine) * FPS
}
