//! Tables of measurements, as CSV and as text for a terminal.

use std::fmt::Write as _;

/// One cell.
#[derive(Clone, Debug, PartialEq)]
pub enum Field {
    /// Words.
    Text(String),
    /// A number; NaN where nothing was found.
    Number(f64),
}

impl From<&str> for Field {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Field {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<f64> for Field {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl Field {
    fn text(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Number(n) if n.is_nan() => "-".to_owned(),
            Self::Number(n) if *n == 0.0 || (1e-3..1e6).contains(&n.abs()) => {
                let digits = (3 - n.abs().max(1e-9).log10().floor() as i32).clamp(0, 6) as usize;
                let fixed = format!("{n:.digits$}");
                if fixed.contains('.') {
                    fixed.trim_end_matches('0').trim_end_matches('.').to_owned()
                } else {
                    fixed
                }
            }
            Self::Number(n) => format!("{n:.2e}"),
        }
    }
}

/// Rows under named columns. Units are in the names.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    columns: Vec<&'static str>,
    rows: Vec<Vec<Field>>,
}

impl Table {
    /// A table without rows.
    pub fn new(columns: &[&'static str]) -> Self {
        Self {
            columns: columns.to_vec(),
            rows: Vec::new(),
        }
    }

    /// Adds a row.
    ///
    /// # Panics
    /// If it has not one field for each column.
    pub fn push(&mut self, row: Vec<Field>) {
        assert_eq!(row.len(), self.columns.len(), "one field for each column");
        self.rows.push(row);
    }

    /// The table as CSV.
    pub fn to_csv(&self) -> String {
        let mut text = self.columns.join(",") + "\n";
        for row in &self.rows {
            let fields: Vec<String> = row.iter().map(|f| quoted(&f.text())).collect();
            text += &(fields.join(",") + "\n");
        }
        text
    }

    /// The table in columns of equal width.
    pub fn to_text(&self) -> String {
        let mut lines = vec![self.columns.iter().map(|c| (*c).to_owned()).collect()];
        lines.extend(
            self.rows
                .iter()
                .map(|r| r.iter().map(Field::text).collect()),
        );
        let lines: Vec<Vec<String>> = lines;
        let width = |k: usize| {
            lines
                .iter()
                .map(|l| l[k].chars().count())
                .max()
                .unwrap_or(0)
        };
        let widths: Vec<usize> = (0..self.columns.len()).map(width).collect();
        let mut text = String::new();
        for line in &lines {
            for (field, width) in line.iter().zip(&widths) {
                let _ = write!(text, "{field:<width$}  ");
            }
            text.truncate(text.trim_end().len());
            text.push('\n');
        }
        text
    }
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_four_digits_and_commas_are_quoted() {
        let mut table = Table::new(&["what", "ms"]);
        table.push(vec!["a, b".into(), 12.345_67.into()]);
        table.push(vec!["c".into(), f64::NAN.into()]);
        table.push(vec!["d".into(), 1e-7.into()]);
        assert_eq!(table.to_csv(), "what,ms\n\"a, b\",12.35\nc,-\nd,1.00e-7\n");
        assert_eq!(
            table.to_text(),
            "what  ms\na, b  12.35\nc     -\nd     1.00e-7\n"
        );
    }
}
