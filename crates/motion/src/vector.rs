//! Vectors in double precision.

/// Euclidean length of a vector.
pub fn length(vector: [f64; 3]) -> f64 {
    let squares = vector.map(|component| component * component);
    squares.iter().sum::<f64>().sqrt()
}

/// The vector with length 1; the zero vector stays.
pub fn unit(vector: [f64; 3]) -> [f64; 3] {
    match length(vector) {
        length if length > 0.0 => vector.map(|value| value / length),
        _ => vector,
    }
}

/// `a + b`.
pub fn plus<const N: usize>(a: [f64; N], b: [f64; N]) -> [f64; N] {
    std::array::from_fn(|i| a[i] + b[i])
}

/// `a - b`.
pub fn minus<const N: usize>(a: [f64; N], b: [f64; N]) -> [f64; N] {
    std::array::from_fn(|i| a[i] - b[i])
}

/// The inner product.
pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The cross product.
pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}
