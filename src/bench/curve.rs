//! Plots as SVG, on linear or logarithmic axes.

use std::ops::Range;

use plotters::chart::ChartBuilder;
use plotters::drawing::IntoDrawingArea as _;
use plotters::element::{Circle, PathElement, Text};
use plotters::prelude::SVGBackend;
use plotters::series::LineSeries;
use plotters::style::{Color as _, RGBColor, WHITE};

use super::Plot;

/// Size of the axes with their labels; the legend is to their right.
const SIZE: (u32, u32) = (720, 440);
/// Size of the legend's letters, and the most that one of them takes on average.
const LETTER: (u32, u32) = (12, 7);
/// Length of a line of the legend, and the space around it.
const LINE: (i32, i32) = (18, 6);
/// Height of the legend's first row, and from one to the next.
const ROWS: (i32, i32) = (48, 20);
const COLORS: [RGBColor; 8] = [
    RGBColor(31, 119, 180),
    RGBColor(214, 39, 40),
    RGBColor(44, 160, 44),
    RGBColor(148, 103, 189),
    RGBColor(255, 127, 14),
    RGBColor(23, 160, 170),
    RGBColor(140, 86, 75),
    RGBColor(90, 90, 90),
];

/// An axis.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Axis {
    /// What it shows, with its unit.
    pub label: String,
    /// Whether steps are factors.
    pub is_logarithmic: bool,
}

impl Axis {
    /// An axis of factors.
    pub fn logarithmic(label: &str) -> Self {
        Self {
            label: label.to_owned(),
            is_logarithmic: true,
        }
    }

    /// An axis of sums.
    pub fn linear(label: &str) -> Self {
        Self {
            label: label.to_owned(),
            is_logarithmic: false,
        }
    }
}

/// Points that belong together.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Name in the legend.
    pub name: String,
    /// Points; those that are not finite, or not positive on a logarithmic axis, are left out.
    pub points: Vec<(f64, f64)>,
}

impl Axis {
    /// Where a value is on the axis; `None` for one that has no place on it.
    fn place(&self, value: f64) -> Option<f64> {
        let place = if self.is_logarithmic {
            value.log10()
        } else {
            value
        };
        place.is_finite().then_some(place)
    }

    /// The label of a place.
    fn tick(&self, place: f64) -> String {
        let value = if self.is_logarithmic {
            10f64.powf(place)
        } else {
            place
        };
        if value == 0.0 || (0.001..10_000.0).contains(&value.abs()) {
            let digits = (1 - value.abs().max(1e-9).log10().floor() as i32).clamp(0, 4) as usize;
            format!("{value:.digits$}")
        } else {
            format!("{value:.0e}")
        }
    }

    /// The part of the axis that some places need, with a margin.
    fn range(&self, places: impl Iterator<Item = f64>) -> Range<f64> {
        let (low, high) = places.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
            (a.min(v), b.max(v))
        });
        if low > high {
            return 0.0..1.0;
        }
        let margin = (0.06 * (high - low)).max(0.05);
        let start = if self.is_logarithmic || low < 0.0 {
            low - margin
        } else {
            0.0
        };
        start..high + margin
    }
}

/// Draws curves; returns the SVG.
///
/// # Panics
/// Never: SVG takes any shape.
pub(super) fn plot(plot: &Plot) -> String {
    let mut svg = String::new();
    draw(plot, &mut svg).expect("SVG takes any shape");
    svg
}

type Drawn = Result<(), Box<dyn std::error::Error>>;

fn draw(plot: &Plot, svg: &mut String) -> Drawn {
    let places: Vec<Vec<(f64, f64)>> = plot
        .curves
        .iter()
        .map(|curve| {
            let place = |(x, y): &(f64, f64)| Some((plot.x.place(*x)?, plot.y.place(*y)?));
            curve.points.iter().filter_map(place).collect()
        })
        .collect();
    let all = || places.iter().flatten();
    let (xs, ys) = (
        plot.x.range(all().map(|p| p.0)),
        plot.y.range(all().map(|p| p.1)),
    );
    let letters = plot.curves.iter().map(|c| c.name.chars().count()).max();
    let legend = letters.unwrap_or(0) as u32 * LETTER.1 + (LINE.0 + 4 * LINE.1) as u32;
    let whole = SVGBackend::with_string(svg, (SIZE.0 + legend, SIZE.1)).into_drawing_area();
    whole.fill(&WHITE)?;
    let (axes, legend) = whole.split_horizontally(SIZE.0);
    let mut chart = ChartBuilder::on(&axes)
        .caption(&plot.title, ("sans-serif", 17))
        .margin(12)
        .x_label_area_size(42)
        .y_label_area_size(64)
        .build_cartesian_2d(xs, ys)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .x_desc(&plot.x.label)
        .y_desc(&plot.y.label)
        .x_label_formatter(&|v| plot.x.tick(*v))
        .y_label_formatter(&|v| plot.y.tick(*v))
        .draw()?;
    for (k, (curve, points)) in plot.curves.iter().zip(&places).enumerate() {
        let color = COLORS[k % COLORS.len()];
        let line = LineSeries::new(points.iter().copied(), color.stroke_width(2));
        chart.draw_series(line)?;
        chart.draw_series(points.iter().map(|p| Circle::new(*p, 3, color.filled())))?;
        let (x, y) = (LINE.1, ROWS.0 + ROWS.1 * k as i32);
        let ends = [(x, y), (x + LINE.0, y)];
        legend.draw(&PathElement::new(ends, color.stroke_width(2)))?;
        let place = (x + LINE.0 + LINE.1, y - LETTER.0 as i32 / 2);
        legend.draw(&Text::new(
            curve.name.as_str(),
            place,
            ("sans-serif", LETTER.0),
        ))?;
    }
    whole.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plot_names_its_curves_and_leaves_out_what_has_no_place() {
        let svg = plot(&Plot {
            title: "error against time".to_owned(),
            x: Axis::logarithmic("time, ms"),
            y: Axis::logarithmic("error, mm"),
            curves: vec![
                Curve {
                    name: "verlet".to_owned(),
                    points: vec![(1.0, 1.0), (10.0, 0.1), (100.0, 0.0), (f64::NAN, 1.0)],
                },
                Curve {
                    name: "nothing".to_owned(),
                    points: Vec::new(),
                },
            ],
        });
        assert!(svg.starts_with("<svg"));
        assert_eq!(svg.matches("<circle").count(), 2);
        for text in ["verlet", "nothing", "time, ms", "error against time"] {
            assert!(svg.contains(text), "{text}");
        }
    }
}
