//! Material libraries of OBJ files: names, diffuse colours, diffuse textures. Everything else is skipped.

/// A material.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Material {
    pub(crate) name: String,
    /// `map_Kd`: the texture as written, without options.
    pub(crate) texture: Option<String>,
    /// Line of `map_Kd`, from 1.
    pub(crate) texture_line: usize,
    /// `Kd`, taken as sRGB, which is what most programs that write it mean.
    pub(crate) color: Option<[f32; 3]>,
}

/// Parses a library. It never fails: what is not understood does not matter here.
pub(crate) fn parse(bytes: &[u8]) -> Vec<Material> {
    let text = String::from_utf8_lossy(bytes);
    let mut materials: Vec<Material> = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        let (keyword, rest) = line
            .split_once(|c: char| c.is_ascii_whitespace())
            .unwrap_or((line, ""));
        let rest = rest.trim();
        if keyword.eq_ignore_ascii_case("newmtl") {
            materials.push(Material {
                name: rest.to_owned(),
                ..Material::default()
            });
            continue;
        }
        let Some(material) = materials.last_mut() else {
            continue;
        };
        if keyword.eq_ignore_ascii_case("map_Kd") {
            let name = without_options(rest);
            if !name.is_empty() {
                material.texture = Some(name.to_owned());
                material.texture_line = number + 1;
            }
        } else if keyword == "Kd" {
            let values: Vec<f32> = rest
                .split_ascii_whitespace()
                .map_while(|w| w.parse().ok())
                .collect();
            if let [r, g, b] = values[..] {
                material.color = Some([r, g, b].map(|v| v.clamp(0.0, 1.0)));
            }
        }
    }
    materials
}

/// The file name of a texture statement: what follows its options, spaces included.
fn without_options(mut rest: &str) -> &str {
    while rest.starts_with('-') {
        let (option, tail) = rest.split_once(' ').unwrap_or((rest, ""));
        let most = match option {
            "-o" | "-s" | "-t" => 3,
            "-mm" => 2,
            "-blendu" | "-blendv" | "-boost" | "-bm" | "-cc" | "-clamp" | "-imfchan"
            | "-texres" | "-type" => 1,
            _ => return rest,
        };
        rest = tail.trim_start();
        for k in 0..most {
            let (word, tail) = rest.split_once(' ').unwrap_or((rest, ""));
            // The second and third number of -o, -s and -t are optional.
            if k > 0 && word.parse::<f32>().is_err() {
                break;
            }
            rest = tail.trim_start();
        }
    }
    rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_options_and_spaces_are_read() {
        let materials = parse(
            b"# c\nKd 1 1 1\nnewmtl skin of a face\r\nKd 0.5 0 2\r\nmap_Kd -s 1 1 -bm 0.5 my face.png\r\nnewmtl b\n\tmap_Kd -clamp on b.jpg\n",
        );
        assert_eq!(materials.len(), 2);
        assert_eq!(materials[0].name, "skin of a face");
        assert_eq!(materials[0].texture.as_deref(), Some("my face.png"));
        assert_eq!(materials[0].texture_line, 5);
        assert_eq!(materials[0].color, Some([0.5, 0.0, 1.0]));
        assert_eq!(materials[1].texture.as_deref(), Some("b.jpg"));
        assert_eq!(without_options("-x 3 a.png"), "-x 3 a.png");
    }
}
