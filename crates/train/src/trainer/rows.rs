//! Parameters concatenated to rows on a device, because one long operation is faster than hundreds
//! of short ones.

use std::collections::BTreeMap;
use std::ops::Range;
use std::rc::Rc;

use burn::tensor::{Device, Tensor, TensorData, Transaction};

/// The rows of the parameters.
#[derive(Debug)]
pub(super) struct Layout {
    /// The parameters of each row, in order.
    rows: Vec<Vec<usize>>,
    /// Row and range of each parameter; `None` for a frozen one.
    places: Vec<Option<(usize, Range<usize>)>>,
}

impl Layout {
    /// Parameters with these lengths, 0 for frozen ones, with one row per class.
    pub fn new<K: Ord>(lengths: &[usize], class_of: impl Fn(usize) -> K) -> Rc<Self> {
        let mut classes: BTreeMap<K, Vec<usize>> = BTreeMap::new();
        for index in (0..lengths.len()).filter(|&index| lengths[index] > 0) {
            classes.entry(class_of(index)).or_default().push(index);
        }
        let rows: Vec<Vec<usize>> = classes.into_values().collect();
        let mut places = vec![None; lengths.len()];
        for (row, parameters) in rows.iter().enumerate() {
            let mut end = 0;
            for &index in parameters {
                places[index] = Some((row, end..end + lengths[index]));
                end += lengths[index];
            }
        }
        Rc::new(Self { rows, places })
    }

    /// The first parameter of each row, whose settings apply to the row.
    pub fn first(&self) -> impl Iterator<Item = usize> {
        self.rows.iter().map(|parameters| parameters[0])
    }
}

/// A number for each element of the trained parameters, on a device.
#[derive(Clone, Debug)]
pub(super) struct Rows {
    pub layout: Rc<Layout>,
    pub rows: Vec<Tensor<1>>,
}

impl Rows {
    /// Rows of one tensor per parameter, in the module's order; zeros for a missing one.
    pub fn joined(layout: &Rc<Layout>, tensors: &[Option<Tensor<1>>], device: &Device) -> Self {
        let part = |index: usize| {
            let (_, place) = layout.places[index].clone().expect("a place in a row");
            let tensor = tensors.get(index).cloned().flatten();
            tensor.unwrap_or_else(|| Tensor::zeros([place.len()], device))
        };
        let row = |parameters: &Vec<usize>| match parameters[..] {
            [one] => part(one),
            _ => Tensor::cat(parameters.iter().map(|&index| part(index)).collect(), 0),
        };
        let rows = layout.rows.iter().map(row).collect();
        Self {
            layout: layout.clone(),
            rows,
        }
    }

    /// Rows of values in main memory.
    pub fn put(layout: &Rc<Layout>, values: &[Vec<f32>], device: &Device) -> Self {
        let row = |parameters: &Vec<usize>| {
            let parts = parameters.iter().map(|&index| &values[index][..]);
            let row = parts.collect::<Vec<_>>().concat();
            let length = row.len();
            Tensor::from_data(TensorData::new(row, [length]), device)
        };
        let rows = layout.rows.iter().map(row).collect();
        Self {
            layout: layout.clone(),
            rows,
        }
    }

    /// The numbers of a trained parameter.
    pub fn part(&self, index: usize) -> Tensor<1> {
        let place = self.layout.places[index].clone();
        let (row, place) = place.expect("a place in a row");
        self.rows[row].clone().slice([place])
    }

    /// The numbers of every parameter in main memory, in one read; empty for a frozen one.
    pub fn read(&self) -> Vec<Vec<f32>> {
        let reading = self.rows.iter().cloned();
        let reading = reading.fold(Transaction::default(), Transaction::register);
        let rows = reading.execute().into_iter();
        let rows: Vec<Vec<f32>> = rows
            .map(|data| data.try_into_vec().expect("states are float32"))
            .collect();
        let places = self.layout.places.iter();
        let values = places.map(|place| match place {
            Some((row, place)) => rows[*row][place.clone()].to_vec(),
            None => Vec::new(),
        });
        values.collect()
    }

    /// The first parameter with a number that is not finite.
    pub fn broken(&self) -> Option<usize> {
        let values = self.read();
        values
            .iter()
            .position(|values| values.iter().any(|value| !value.is_finite()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_of_a_class_share_a_row() {
        let device = Device::flex();
        // The third is frozen.
        let layout = Layout::new(&[2, 1, 0, 3], |index| index == 1);
        let values = [vec![1.0, 2.0], vec![3.0], Vec::new(), vec![4.0, 5.0, 6.0]];
        let rows = Rows::put(&layout, &values, &device);
        assert_eq!(rows.rows.len(), 2);
        assert_eq!(layout.first().collect::<Vec<_>>(), [0, 1]);
        assert_eq!(rows.read(), values);
        assert_eq!(rows.broken(), None);
        let tensors = [None, Some(rows.part(1)), None, Some(rows.part(3))];
        let mut joined = Rows::joined(&layout, &tensors, &device);
        let expected = [vec![0.0; 2], vec![3.0], Vec::new(), vec![4.0, 5.0, 6.0]];
        assert_eq!(joined.read(), expected);
        joined.rows[0] = joined.rows[0].clone().div_scalar(0.0);
        assert_eq!(joined.broken(), Some(0));
    }
}
