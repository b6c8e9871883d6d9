//! A small software renderer: z-buffer, ambient occlusion, supersampling.
//!
//! Everything is lit in the camera frame of the [`View`], in linear light, at `SAMPLES`^2 samples
//! a pixel. The background stays transparent but for a soft shadow on the ground.

use super::light::Lighting;
use super::shape::{Facet, surface_facets, tool_facets};
use super::{Surface, ToolPose, View};
use nalgebra::Vector3;

type V3 = Vector3<f32>;

/// Samples a pixel along each axis.
const SAMPLES: usize = 3;
/// Largest width or height of a picture in px.
const LARGEST: usize = 4096;
/// No facet.
pub(super) const NOTHING: u32 = u32::MAX;

/// Straight-alpha sRGB, row by row from the top.
#[derive(Clone, Debug)]
pub struct Image {
    pub width: usize,
    pub height: usize,
    pub rgba: Vec<u8>,
}

impl Image {
    /// The picture as a PNG file.
    pub fn png(&self) -> Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::High);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.rgba)?;
        writer.finish()?;
        Ok(bytes)
    }
}

/// Draws an organ and tools as `view` sees them, `width` by `height` px (1 to 4096).
pub fn render(
    view: &View,
    surface: &Surface,
    tools: &[ToolPose],
    width: usize,
    height: usize,
) -> Image {
    let (width, height) = (width.clamp(1, LARGEST), height.clamp(1, LARGEST));
    let mut facets = surface_facets(surface, view);
    let organ = facets.len();
    facets.extend(tools.iter().flat_map(|tool| tool_facets(tool, view)));
    let light = Lighting::new(view, &facets, organ);
    let picture = Picture::new(view, &facets, width, height);
    let occlusion = picture.occlusion();
    let mut rgba = vec![0; width * height * 4];
    let threads = std::thread::available_parallelism()
        .map_or(1, usize::from)
        .min(16);
    let band = height.div_ceil(threads);
    std::thread::scope(|scope| {
        for (i, rows) in rgba.chunks_mut(band * width * 4).enumerate() {
            let (picture, light, occlusion) = (&picture, &light, &occlusion);
            scope.spawn(move || {
                for (j, pixel) in rows.chunks_exact_mut(4).enumerate() {
                    let (x, y) = (j % width, i * band + j / width);
                    pixel.copy_from_slice(&picture.pixel(x, y, light, occlusion));
                }
            });
        }
    });
    Image {
        width,
        height,
        rgba,
    }
}

/// The nearest facet of each sample.
pub(super) struct Grid {
    width: usize,
    height: usize,
    /// Larger is nearer; 0 is nothing.
    pub(super) nearness: Vec<f32>,
    pub(super) facet: Vec<u32>,
}

impl Grid {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            nearness: vec![0.0; width * height],
            facet: vec![NOTHING; width * height],
        }
    }

    /// Draws a triangle of corners (x, y in samples, nearness > 0).
    pub(super) fn draw(&mut self, corners: &[[f32; 3]; 3], facet: u32) {
        let [a, b, c] = corners;
        let area = edge(a, b, c[0], c[1]);
        if !area.is_normal() {
            return;
        }
        let range = |k: usize, size: usize| {
            let low = a[k].min(b[k]).min(c[k]) - 0.5;
            let high = a[k].max(b[k]).max(c[k]) - 0.5;
            (
                low.ceil().max(0.0) as usize,
                (high.floor() + 1.0).clamp(0.0, size as f32) as usize,
            )
        };
        let (left, right) = range(0, self.width);
        let (top, bottom) = range(1, self.height);
        for y in top..bottom {
            for x in left..right {
                let (px, py) = (x as f32 + 0.5, y as f32 + 0.5);
                let u = edge(b, c, px, py) / area;
                let v = edge(c, a, px, py) / area;
                let w = 1.0 - u - v;
                if u < -1e-5 || v < -1e-5 || w < -1e-5 {
                    continue;
                }
                let nearness = u * a[2] + v * b[2] + w * c[2];
                let sample = y * self.width + x;
                if nearness > self.nearness[sample] {
                    self.nearness[sample] = nearness;
                    self.facet[sample] = facet;
                }
            }
        }
    }
}

/// Twice the signed area of the triangle a, b, (x, y).
fn edge(a: &[f32; 3], b: &[f32; 3], x: f32, y: f32) -> f32 {
    (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
}

/// A visible point of a facet.
pub(super) struct Hit {
    pub position: V3,
    pub normal: V3,
    pub tint: f32,
}

struct Picture<'a> {
    view: &'a View,
    facets: &'a [Facet],
    grid: Grid,
    /// Samples per unit of picture coordinates, both ways.
    scale: [f32; 2],
}

impl<'a> Picture<'a> {
    fn new(view: &'a View, facets: &'a [Facet], width: usize, height: usize) -> Self {
        let mut grid = Grid::new(width * SAMPLES, height * SAMPLES);
        // Fit the view's aspect into the picture's.
        let unit = (width as f32 / view.half[0]).min(height as f32 / view.half[1]);
        let scale = view.half.map(|h| unit * h * SAMPLES as f32 / 2.0);
        let mut picture = Self {
            view,
            facets,
            grid: Grid::new(0, 0),
            scale,
        };
        let near = view.eye.z - 0.05;
        for (i, facet) in facets.iter().enumerate() {
            let inside = clip(facet.corners.map(|c| c.position), near);
            for k in 2..inside.len() {
                let corners = [inside[0], inside[k - 1], inside[k]];
                grid.draw(
                    &corners.map(|p| picture.sample_of(&p, width, height)),
                    i as u32,
                );
            }
        }
        picture.grid = grid;
        picture
    }

    fn sample_of(&self, position: &V3, width: usize, height: usize) -> [f32; 3] {
        let [x, y, inverse] = self.view.project(position);
        let center = [width, height].map(|n| (n * SAMPLES) as f32 / 2.0);
        [
            center[0] + x * self.scale[0],
            center[1] - y * self.scale[1],
            inverse,
        ]
    }

    /// Direction from the eye through a sample, with z = -1.
    fn ray(&self, x: f32, y: f32) -> V3 {
        let right = (x - self.grid.width as f32 / 2.0) / self.scale[0] * self.view.half[0];
        let up = (self.grid.height as f32 / 2.0 - y) / self.scale[1] * self.view.half[1];
        V3::new(right, up, -1.0)
    }

    fn hit(&self, x: usize, y: usize) -> Option<(Hit, &Facet)> {
        let sample = y * self.grid.width + x;
        let facet = self.facets.get(self.grid.facet[sample] as usize)?;
        let ray = self.ray(x as f32 + 0.5, y as f32 + 0.5);
        let position = self.view.eye + ray / self.grid.nearness[sample];
        let [a, b, c] = &facet.corners;
        let (ab, ac) = (b.position - a.position, c.position - a.position);
        let area = ab.cross(&ac);
        let from_a = position - a.position;
        let v = from_a.cross(&ac).dot(&area) / area.norm_squared();
        let w = ab.cross(&from_a).dot(&area) / area.norm_squared();
        let (v, w) = if v.is_finite() && w.is_finite() {
            (v, w)
        } else {
            (0.0, 0.0)
        };
        let (v, w) = (v.clamp(0.0, 1.0), w.clamp(0.0, 1.0));
        let u = (1.0 - v - w).max(0.0);
        let normal = a.normal * u + b.normal * v + c.normal * w;
        let hit = Hit {
            position,
            normal: normal.try_normalize(1e-9).unwrap_or(a.normal),
            tint: a.tint * u + b.tint * v + c.tint * w,
        };
        Some((hit, facet))
    }

    /// Share of the hemisphere hidden near each pixel, from the depths around it, blurred.
    fn occlusion(&self) -> Field {
        const DIRECTIONS: usize = 10;
        const RINGS: usize = 5;
        const REACH: f32 = 0.16;
        let (width, height) = (self.grid.width / SAMPLES, self.grid.height / SAMPLES);
        let middle = SAMPLES / 2;
        let mut position = vec![None; width * height];
        for y in 0..height {
            for x in 0..width {
                let hit = self.hit(x * SAMPLES + middle, y * SAMPLES + middle);
                position[y * width + x] = hit.map(|(h, _)| (h.position, h.normal));
            }
        }
        let mut field = Field::new(width, height);
        for y in 0..height {
            for x in 0..width {
                let Some((p, n)) = position[y * width + x] else {
                    continue;
                };
                let distance = self.view.eye.z - p.z;
                let reach = REACH * self.scale[1] / SAMPLES as f32 / (distance * self.view.half[1]);
                let mut hidden = 0.0;
                for d in 0..DIRECTIONS {
                    let angle = d as f32 / DIRECTIONS as f32 * std::f32::consts::TAU;
                    let mut highest: f32 = 0.0;
                    for ring in 1..=RINGS {
                        let step = (ring as f32 / RINGS as f32).powf(1.4) * reach;
                        let qx = (x as f32 + angle.cos() * step).round();
                        let qy = (y as f32 + angle.sin() * step).round();
                        if qx < 0.0 || qy < 0.0 || qx >= width as f32 || qy >= height as f32 {
                            continue;
                        }
                        let Some((q, _)) = position[qy as usize * width + qx as usize] else {
                            continue;
                        };
                        let gap = q - p;
                        let length = gap.norm().max(1e-6);
                        let falloff = 1.0 - (length / (1.6 * REACH)).min(1.0).powi(2);
                        let rise = (gap.dot(&n) / length - 0.12).max(0.0);
                        highest = highest.max(rise * falloff);
                    }
                    hidden += highest;
                }
                field.values[y * width + x] = hidden / DIRECTIONS as f32;
            }
        }
        let radius = (height / 200).max(1);
        field.blur(radius);
        field.blur(radius);
        field
    }

    /// Whether one sample can stand for all of a pixel: empty, or a smooth piece of one thing.
    fn is_even(&self, left: usize, top: usize) -> bool {
        let facet = |x: usize, y: usize| self.grid.facet[y * self.grid.width + x];
        let first = facet(left, top);
        let mut samples = (0..SAMPLES * SAMPLES).map(|i| (left + i % SAMPLES, top + i / SAMPLES));
        if samples.clone().all(|(x, y)| facet(x, y) == first) {
            return true;
        }
        let middle = self.hit(left + SAMPLES / 2, top + SAMPLES / 2);
        samples.all(|(x, y)| match (&middle, self.hit(x, y)) {
            (None, None) => true,
            (Some((a, f)), Some((b, g))) => {
                f.finish == g.finish
                    && f.color == g.color
                    && a.normal.dot(&b.normal) > 0.985
                    && (a.tint - b.tint).abs() < 0.1
                    && (a.position - b.position).norm() < 0.03
            }
            _ => false,
        })
    }

    /// Straight-alpha sRGB of a pixel.
    fn pixel(&self, x: usize, y: usize, light: &Lighting, occlusion: &Field) -> [u8; 4] {
        let hidden = occlusion.values[y * occlusion.width + x];
        let (left, top) = (x * SAMPLES, y * SAMPLES);
        let mut sum = V3::zeros();
        let mut alpha = 0.0;
        let mut count = 0.0;
        let single = self.is_even(left, top);
        let (first, last) = if single {
            (SAMPLES / 2, SAMPLES / 2)
        } else {
            (0, SAMPLES - 1)
        };
        for sy in top + first..=top + last {
            for sx in left + first..=left + last {
                count += 1.0;
                let ray = self.ray(sx as f32 + 0.5, sy as f32 + 0.5);
                if let Some((hit, facet)) = self.hit(sx, sy) {
                    sum += tone(light.shade(&hit, facet, &-ray.normalize(), 1.0 - 1.5 * hidden));
                    alpha += 1.0;
                } else {
                    alpha += light.ground_shadow(&self.view.eye, &ray);
                }
            }
        }
        if alpha < 1e-3 {
            return [0; 4];
        }
        let [r, g, b]: [f32; 3] = (sum / alpha).into();
        let opacity = alpha / count;
        [
            encode(r),
            encode(g),
            encode(b),
            (opacity * 255.0).round() as u8,
        ]
    }
}

/// The part of a triangle with z below `near`.
fn clip(corners: [V3; 3], near: f32) -> Vec<V3> {
    let mut inside = Vec::with_capacity(4);
    for k in 0..3 {
        let (p, q) = (corners[k], corners[(k + 1) % 3]);
        if p.z < near {
            inside.push(p);
        }
        if (p.z < near) != (q.z < near) {
            inside.push(p + (q - p) * ((near - p.z) / (q.z - p.z)));
        }
    }
    inside
}

/// Linear light to an sRGB byte.
fn encode(linear: f32) -> u8 {
    let x = linear.clamp(0.0, 1.0);
    let srgb = if x <= 0.003_130_8 {
        12.92 * x
    } else {
        1.055 * x.powf(1.0 / 2.4) - 0.055
    };
    (srgb * 255.0).round() as u8
}

/// A soft shoulder for highlights.
fn tone(color: V3) -> V3 {
    color.map(|x| {
        let x = x.max(0.0);
        if x < 0.6 {
            x
        } else {
            1.0 - 0.4 * (-(x - 0.6) / 0.4).exp()
        }
    })
}

/// A scalar per pixel.
pub(super) struct Field {
    width: usize,
    height: usize,
    pub(super) values: Vec<f32>,
}

impl Field {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            values: vec![0.0; width * height],
        }
    }

    /// A box blur over 2 radius + 1 values, along rows, then columns.
    pub(super) fn blur(&mut self, radius: usize) {
        let (width, height) = (self.width, self.height);
        blur_lines(&mut self.values, width, height, [1, width], radius);
        blur_lines(&mut self.values, height, width, [width, 1], radius);
    }

    /// Bilinear, 0 outside.
    pub(super) fn at(&self, x: f32, y: f32) -> f32 {
        let (x, y) = (x - 0.5, y - 0.5);
        let (left, top) = (x.floor(), y.floor());
        let get = |i: f32, j: f32| {
            if i < 0.0 || j < 0.0 || i >= self.width as f32 || j >= self.height as f32 {
                return 0.0;
            }
            self.values[j as usize * self.width + i as usize]
        };
        let (u, v) = (x - left, y - top);
        let upper = get(left, top) * (1.0 - u) + get(left + 1.0, top) * u;
        let lower = get(left, top + 1.0) * (1.0 - u) + get(left + 1.0, top + 1.0) * u;
        upper * (1.0 - v) + lower * v
    }
}

/// Blurs `lines` runs of `length` values; `strides` leads to the next value and the next run.
fn blur_lines(values: &mut [f32], length: usize, lines: usize, strides: [usize; 2], radius: usize) {
    let mut run = vec![0.0; length];
    for line in 0..lines {
        let at = |i: usize| line * strides[1] + i * strides[0];
        let mut sum: f32 = (0..radius.min(length)).map(|i| values[at(i)]).sum();
        for (i, blurred) in run.iter_mut().enumerate() {
            if i + radius < length {
                sum += values[at(i + radius)];
            }
            if i > radius {
                sum -= values[at(i - radius - 1)];
            }
            *blurred = sum / (2 * radius + 1) as f32;
        }
        for (i, &blurred) in run.iter().enumerate() {
            values[at(i)] = blurred;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Tint;
    use super::*;

    const VERTICES: [[f64; 3]; 4] = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    const TRIANGLES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];

    fn view() -> View {
        View::framing([1.0, -1.0, 0.8], [0.0, 0.0, 1.0], 4.0 / 3.0, &VERTICES)
    }

    #[test]
    fn a_solid_covers_the_middle_and_not_the_corners() {
        let surface = Surface {
            vertices: &VERTICES,
            triangles: &TRIANGLES,
            tint: Tint::None,
        };
        let image = render(&view(), &surface, &[], 40, 30);
        let alpha = |x: usize, y: usize| image.rgba[(y * 40 + x) * 4 + 3];
        assert_eq!(image.rgba.len(), 40 * 30 * 4);
        assert_eq!(alpha(20, 15), 255);
        assert_eq!(alpha(0, 0), 0);
        let again = render(&view(), &surface, &[], 40, 30);
        assert_eq!(image.rgba, again.rgba);
    }

    #[test]
    fn emptiness_is_transparent_and_has_a_png() {
        let nan = [[f64::NAN; 3]; 3];
        for (vertices, triangles) in [(&[][..], &[][..]), (&nan[..], &[[0, 1, 2]][..])] {
            let surface = Surface {
                vertices,
                triangles,
                tint: Tint::Vertices(&[f32::NAN]),
            };
            let image = render(&view(), &surface, &[], 0, 5);
            assert!(image.rgba.iter().all(|&byte| byte == 0));
            assert!(image.png().is_ok_and(|png| png.starts_with(b"\x89PNG")));
        }
    }

    #[test]
    fn the_nearer_triangle_wins() {
        let mut grid = Grid::new(4, 4);
        let flat = |nearness: f32| {
            [
                [0.0, 0.0, nearness],
                [9.0, 0.0, nearness],
                [0.0, 9.0, nearness],
            ]
        };
        grid.draw(&flat(0.5), 0);
        grid.draw(&flat(0.7), 1);
        grid.draw(&flat(0.6), 2);
        assert_eq!(grid.facet[0], 1);
    }

    #[test]
    fn clipping_keeps_the_far_side() {
        let corners = [
            V3::new(0.0, 0.0, 0.0),
            V3::new(0.0, 0.0, 2.0),
            V3::new(1.0, 0.0, 0.0),
        ];
        let kept = clip(corners, 1.0);
        assert_eq!(kept.len(), 4);
        assert!(kept.iter().all(|p| p.z <= 1.0));
        assert!(clip(corners.map(|p| p + V3::new(0.0, 0.0, 5.0)), 1.0).is_empty());
    }
}
