//! HTML and SVG of the report. Tags are closed as in XML, so that any parser reads it.

use std::fmt::Write as _;

const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:76em;padding:0 1em;color:#222}\
h1{font-size:1.6em}h2{font-size:1.2em;border-bottom:1px solid #ccc;margin-top:1.6em}table{border-collapse:collapse}\
th,td{text-align:left;vertical-align:top;padding:.15em .9em .15em 0}th{font-weight:600}svg{margin:.4em 1.6em .4em 0;\
vertical-align:top}img{max-width:100%}nav a{margin-right:1em}";

/// A page that is being written.
pub(super) struct Page {
    head: String,
    links: String,
    body: String,
}

impl Page {
    pub(super) fn new(title: &str) -> Self {
        let title = escaped(title);
        Self {
            head: format!(
                "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"/><title>{title}</title>\
                 <style>{STYLE}</style></head><body><h1>{title}</h1>"
            ),
            links: String::new(),
            body: String::new(),
        }
    }

    /// Adds a section; `content` is HTML.
    pub(super) fn section(&mut self, id: &str, title: &str, content: &str) {
        let title = escaped(title);
        let _ = write!(self.links, "<a href=\"#{id}\">{title}</a>");
        let _ = writeln!(
            self.body,
            "<section id=\"{id}\"><h2>{title}</h2>{content}</section>"
        );
    }

    pub(super) fn end(self) -> String {
        format!(
            "{}<nav>{}</nav>\n{}</body></html>\n",
            self.head, self.links, self.body
        )
    }
}

/// Text as it may stand in HTML.
pub(super) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            c if c.is_control() && c != '\n' => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

/// A bar for each row.
pub(super) fn bars(title: &str, unit: &str, rows: &[(String, u64)]) -> String {
    const ROW: usize = 19;
    const NAMES: usize = 190;
    const LONGEST: f64 = 240.0;
    const MOST: usize = 40;
    let largest = rows.iter().map(|(_, n)| *n).max().unwrap_or(0).max(1) as f64;
    let shown = rows.len().min(MOST);
    let height = ROW * (shown + 1) + 8 + if rows.len() > MOST { ROW } else { 0 };
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"520\" height=\"{height}\" font-size=\"13\" role=\"img\">\
         <title>{0}</title><text x=\"0\" y=\"14\" font-weight=\"600\">{0} ({unit})</text>",
        escaped(title)
    );
    for (i, (name, n)) in rows.iter().take(MOST).enumerate() {
        let y = ROW * (i + 1) + 4;
        let width = LONGEST * *n as f64 / largest;
        let _ = write!(
            out,
            "<text x=\"{0}\" y=\"{1}\" text-anchor=\"end\">{2}</text>\
             <rect x=\"{NAMES}\" y=\"{3}\" width=\"{width:.1}\" height=\"{4}\" fill=\"#4a7ab5\"/>\
             <text x=\"{5:.1}\" y=\"{1}\">{n}</text>",
            NAMES - 6,
            y + 13,
            escaped(&name.chars().take(28).collect::<String>()),
            y + 2,
            ROW - 5,
            NAMES as f64 + width + 6.0,
        );
    }
    if rows.len() > MOST {
        let y = ROW * (MOST + 1) + 17;
        let _ = write!(
            out,
            "<text x=\"{NAMES}\" y=\"{y}\">and {} more</text>",
            rows.len() - MOST
        );
    }
    out + "</svg>"
}

pub(super) fn picture(png: &[u8], alt: &str) -> String {
    format!(
        "<img width=\"96\" alt=\"{}\" src=\"{}\"/>",
        escaped(alt),
        data_uri(png)
    )
}

/// A PNG inside the page.
pub(super) fn data_uri(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", base64(png))
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let bits = group
            .iter()
            .fold(0_u32, |bits, b| (bits << 8) | u32::from(*b))
            << (8 * (3 - group.len()));
        for i in 0..4 {
            let digit = DIGITS[((bits >> (18 - 6 * i)) & 63) as usize];
            out.push(if i <= group.len() {
                char::from(digit)
            } else {
                '='
            });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_rfc_4648() {
        let cases = [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foobar", "Zm9vYmFy"),
        ];
        for (text, code) in cases {
            assert_eq!(base64(text.as_bytes()), code);
        }
    }

    #[test]
    fn names_cannot_break_the_page() {
        let svg = bars("<b>", "x", &[("a & \"b\" </svg>".to_owned(), 3)]);
        assert!(svg.contains("&lt;b&gt;") && svg.contains("a &amp; &quot;b&quot; &lt;/svg&gt;"));
        assert_eq!(svg.matches("</svg>").count(), 1);
    }
}
