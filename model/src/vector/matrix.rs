//! Weights as plain numbers, and products of them.

/// A matrix, row-major.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Matrix {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    values: Vec<f32>,
}

impl Matrix {
    pub(crate) fn new(rows: usize, columns: usize, values: Vec<f32>) -> Self {
        debug_assert_eq!(values.len(), rows * columns);
        Self { rows, columns, values }
    }

    pub(crate) fn row(&self, row: usize) -> &[f32] {
        &self.values[row * self.columns..(row + 1) * self.columns]
    }

    /// `self other`, summed in double precision.
    pub(crate) fn times(&self, other: &Self) -> Self {
        let mut values = Vec::with_capacity(self.rows * other.columns);
        for row in 0..self.rows {
            let mut sums = vec![0.0f64; other.columns];
            for (inner, &a) in self.row(row).iter().enumerate() {
                for (sum, &b) in sums.iter_mut().zip(other.row(inner)) {
                    *sum += f64::from(a) * f64::from(b);
                }
            }
            values.extend(sums.iter().map(|&sum| sum as f32));
        }
        Self::new(self.rows, other.columns, values)
    }

    /// `self vector + offset`, summed in double precision.
    pub(crate) fn apply(&self, vector: &[f32], offset: &[f32]) -> Vec<f32> {
        let products =
            |row: usize| self.row(row).iter().zip(vector).map(|(&a, &b)| f64::from(a) * f64::from(b));
        (0..self.rows).map(|row| (products(row).sum::<f64>() + f64::from(offset[row])) as f32).collect()
    }

    pub(crate) fn transposed(&self) -> Self {
        let values = (0..self.columns).flat_map(|c| (0..self.rows).map(move |r| self.row(r)[c])).collect();
        Self::new(self.columns, self.rows, values)
    }

    pub(crate) fn scaled(mut self, factor: f64) -> Self {
        for value in &mut self.values {
            *value = (f64::from(*value) * factor) as f32;
        }
        self
    }

    /// Columns `start..end`.
    pub(crate) fn columns(&self, start: usize, end: usize) -> Self {
        let values = (0..self.rows).flat_map(|row| self.row(row)[start..end].iter().copied()).collect();
        Self::new(self.rows, end - start, values)
    }

    /// Another matrix below this one.
    pub(crate) fn above(mut self, below: &Self) -> Self {
        debug_assert_eq!(self.columns, below.columns);
        self.values.extend_from_slice(&below.values);
        Self::new(self.rows + below.rows, self.columns, self.values)
    }

    /// Another matrix to the right of this one.
    pub(crate) fn beside(&self, right: &Self) -> Self {
        debug_assert_eq!(self.rows, right.rows);
        let values = (0..self.rows).flat_map(|r| self.row(r).iter().chain(right.row(r)).copied()).collect();
        Self::new(self.rows, self.columns + right.columns, values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix(rows: usize, columns: usize, values: &[f32]) -> Matrix {
        Matrix::new(rows, columns, values.to_vec())
    }

    #[test]
    fn products_are_those_of_matrices() {
        let a = matrix(2, 3, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        let b = matrix(3, 2, &[1.0, 0.0, 0.0, 1.0, 2.0, 2.0]);
        assert_eq!(a.times(&b), matrix(2, 2, &[7.0, 8.0, 16.0, 17.0]));
        assert_eq!(a.apply(&[1.0, 0.0, -1.0], &[10.0, 20.0]), [8.0, 18.0]);
        assert_eq!(a.transposed(), matrix(3, 2, &[1.0, 4.0, 2.0, 5.0, 3.0, 6.0]));
    }

    #[test]
    fn parts_are_cut_and_joined() {
        let a = matrix(2, 2, &[1.0, 2.0, 3.0, 4.0]);
        assert_eq!(a.columns(1, 2), matrix(2, 1, &[2.0, 4.0]));
        assert_eq!(a.beside(&a.columns(0, 1)), matrix(2, 3, &[1.0, 2.0, 1.0, 3.0, 4.0, 3.0]));
        assert_eq!(a.clone().above(&a).rows, 4);
        assert_eq!(a.scaled(0.5).row(1), [1.5, 2.0]);
    }
}
