//! The emphasis projection as a part of a network's weights.

use burn::module::{Module, Param};
use burn::tensor::Tensor;
use kinegrad_models::Initializer;

/// The frozen matrix of a network's space, `[channels, channels]`: a frame is a row vector and `y =
/// x P` (Guided Motion Diffusion, appendix C). The matrix is one of the weights, so that a
/// checkpoint determines its space.
#[derive(Module, Debug)]
pub struct Projection {
    matrix: Param<Tensor<2>>,
}

impl Projection {
    /// The given matrix, row by row.
    ///
    /// # Panics
    /// If the matrix is not square.
    pub fn new(matrix: Vec<f32>, channels: usize, init: &Initializer) -> Self {
        assert_eq!(matrix.len(), channels * channels, "a square matrix");
        let matrix = init.values([channels, channels], matrix);
        Self {
            matrix: matrix.set_require_grad(false),
        }
    }

    /// `x P` of every frame.
    ///
    /// # Shapes
    /// - x, output: `[batch, channels, time]`
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        self.matrix.val().transpose().unsqueeze::<3>().matmul(x)
    }

    /// The matrix on the host, row by row.
    ///
    /// # Panics
    /// If the parameter is not of single precision.
    pub fn to_host(&self) -> Vec<f32> {
        let values = self.matrix.val().inner().try_into_vec_as::<f32>();
        values.expect("parameters are float32")
    }
}
