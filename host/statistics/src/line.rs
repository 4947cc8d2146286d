//! A straight line through points.

/// The straight line through points by least squares.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Line {
    /// The mean of the points, which is on the line; zero without points.
    pub middle: [f64; 2],
    /// Its slope; zero if all points have the same abscissa.
    pub slope: f64,
    /// The sum of the squared distances of the abscissas from their mean.
    pub spread: f64,
}

impl Line {
    /// The line through points of abscissa and ordinate.
    pub fn through(points: impl Iterator<Item = [f64; 2]> + Clone) -> Self {
        let count = points.clone().count().max(1) as f64;
        let mean = |axis: usize| points.clone().map(|point| point[axis]).sum::<f64>() / count;
        let middle = [mean(0), mean(1)];
        let (mut spread, mut product) = (0.0, 0.0);
        for [x, y] in points {
            spread += (x - middle[0]) * (x - middle[0]);
            product += (x - middle[0]) * (y - middle[1]);
        }
        Self {
            middle,
            slope: if spread > 0.0 { product / spread } else { 0.0 },
            spread,
        }
    }

    /// The ordinate at an abscissa.
    #[must_use]
    pub fn at(&self, x: f64) -> f64 {
        self.middle[1] + self.slope * (x - self.middle[0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_that_of_the_book() {
        let points = [[1.0, 6.0], [2.0, 5.0], [3.0, 7.0], [4.0, 10.0]];
        let line = Line::through(points.into_iter());
        assert_eq!((line.middle, line.spread), ([2.5, 7.0], 5.0));
        assert!((line.slope - 1.4).abs() < 1e-12 && (line.at(0.0) - 3.5).abs() < 1e-12);
    }

    #[test]
    fn points_that_show_no_slope_have_none() {
        let line = Line::through([[2.0, 1.0], [2.0, 3.0]].into_iter());
        assert_eq!((line.slope, line.at(9.0)), (0.0, 2.0));
        assert_eq!(Line::through([].into_iter()), Line::default());
    }
}
