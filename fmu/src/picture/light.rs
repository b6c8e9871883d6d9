//! Light on tissue, steel and plastic: three lamps, a shadow map, a mirrored studio.

use super::View;
use super::raster::{Field, Grid, Hit, NOTHING};
use super::shape::{Facet, Finish};
use nalgebra::Vector3;

type V3 = Vector3<f32>;

/// A plane grid of `size`^2 texels over a square of half side `reach` about the origin.
struct Plane {
    axes: [V3; 3],
    reach: f32,
    size: usize,
}

impl Plane {
    /// Looking against `normal`.
    fn new(normal: V3, reach: f32, size: usize) -> Self {
        let helper = if normal.x.abs() < 0.7 {
            V3::x()
        } else {
            V3::y()
        };
        let right = helper.cross(&normal).normalize();
        Self {
            axes: [right, normal.cross(&right), normal],
            reach,
            size,
        }
    }

    /// Texel coordinates and height along the normal.
    fn place(&self, p: &V3) -> [f32; 3] {
        let texel = |k: usize| (self.axes[k].dot(p) / self.reach + 1.0) / 2.0 * self.size as f32;
        [texel(0), texel(1), self.axes[2].dot(p)]
    }

    /// Nearest facets as seen against the normal; nearness is height above -`reach`.
    fn grid(&self, facets: &[Facet]) -> Grid {
        let mut grid = Grid::new(self.size, self.size);
        for (i, facet) in facets.iter().enumerate() {
            let corners = facet.corners.map(|c| {
                let [x, y, height] = self.place(&c.position);
                [x, y, (height + self.reach).max(1e-6)]
            });
            grid.draw(&corners, i as u32);
        }
        grid
    }
}

/// Direction towards a light in the camera frame, and its colour.
struct Lamp {
    direction: V3,
    color: V3,
}

/// The light of one panel, shadows included.
pub(super) struct Lighting {
    key: Lamp,
    fill: Lamp,
    rim: Lamp,
    up: V3,
    shadow_plane: Plane,
    shadow: Vec<f32>,
    ground_plane: Plane,
    ground: f32,
    ground_shadow: Field,
}

impl Lighting {
    pub(super) fn new(view: &View, facets: &[Facet], organ: usize) -> Self {
        let lamp = |direction: [f32; 3], color: [f32; 3]| Lamp {
            direction: V3::from(direction).normalize(),
            color: V3::from(color),
        };
        let key = lamp([-0.50, 0.78, 0.62], [2.05, 1.98, 1.88]);
        let shadow_plane = Plane::new(key.direction, 1.7, 1400);
        let shadow = shadow_plane.grid(facets).nearness;

        let ground_plane = Plane::new(view.up, 2.6, 320);
        let covered = ground_plane.grid(&facets[..organ]).facet;
        let mut ground_shadow = Field::new(ground_plane.size, ground_plane.size);
        for (value, facet) in ground_shadow.values.iter_mut().zip(covered) {
            *value = f32::from(u8::from(facet != NOTHING));
        }
        for _ in 0..3 {
            ground_shadow.blur(9);
        }
        Self {
            key,
            fill: lamp([0.90, 0.10, 0.55], [0.34, 0.38, 0.46]),
            rim: lamp([0.45, 0.62, -0.75], [1.10, 1.12, 1.20]),
            up: view.up,
            shadow_plane,
            shadow,
            ground_plane,
            ground: view.ground,
            ground_shadow,
        }
    }

    /// Share of the key light that arrives: 16 taps on a disc in the shadow map.
    fn key_share(&self, hit: &Hit) -> f32 {
        const TAPS: usize = 16;
        const DISC: f32 = 7.0;
        let slope = hit.normal.dot(&self.key.direction);
        if slope <= 0.0 {
            return 0.0;
        }
        let [x, y, height] = self
            .shadow_plane
            .place(&(hit.position + hit.normal * 0.006));
        let bias = 0.006 + 0.012 * (1.0 - slope);
        let size = self.shadow_plane.size;
        let mut lit = 0.0;
        for tap in 0..TAPS {
            let radius = DISC * ((tap as f32 + 0.5) / TAPS as f32).sqrt();
            let (sin, cos) = (tap as f32 * 2.399_963).sin_cos();
            let (u, v) = (x + radius * cos, y + radius * sin);
            let outside = u < 0.0 || v < 0.0 || u >= size as f32 || v >= size as f32;
            let top = if outside {
                0.0
            } else {
                self.shadow[v as usize * size + u as usize]
            };
            // A soft step instead of a comparison: no bands between the taps.
            let above = top - self.shadow_plane.reach - height - bias;
            lit += 1.0 - (above / 0.008).clamp(0.0, 1.0);
        }
        lit / TAPS as f32
    }

    /// Opacity of the shadow where a ray from the eye meets the ground.
    pub(super) fn ground_shadow(&self, eye: &V3, ray: &V3) -> f32 {
        let descent = -ray.dot(&self.up);
        let distance = (eye.dot(&self.up) - self.ground) / descent;
        if !distance.is_finite() || distance <= 0.0 || descent < 1e-3 {
            return 0.0;
        }
        let away = self.key.direction - self.up * self.key.direction.dot(&self.up);
        let point = eye + ray * distance + away * 0.10;
        let [x, y, _] = self.ground_plane.place(&point);
        0.36 * self.ground_shadow.at(x, y)
    }

    /// Linear light a point sends to the eye; `open` is the unoccluded share of its hemisphere.
    pub(super) fn shade(&self, hit: &Hit, facet: &Facet, to_eye: &V3, open: f32) -> V3 {
        let open = open.clamp(0.15, 1.0);
        let key = self.key_share(hit);
        match facet.finish {
            Finish::Tissue => self.tissue(hit, to_eye, key, open),
            Finish::Steel => self.steel(hit, linear(facet.color), to_eye, key, open),
            Finish::Plastic => self.plastic(hit, linear(facet.color), to_eye, key, open),
            Finish::Glow => {
                let facing = hit.normal.dot(to_eye).max(0.0);
                linear(facet.color) * 0.7 + V3::new(1.0, 0.85, 0.55) * (0.75 * facing.powi(3))
            }
        }
    }

    fn tissue(&self, hit: &Hit, to_eye: &V3, key: f32, open: f32) -> V3 {
        let skin = linear([108, 40, 31]);
        let raw = linear([214, 88, 82]);
        let albedo = skin + (raw - skin) * hit.tint;
        // Light that enters and leaves elsewhere: red reaches furthest round the terminator.
        let wrap = V3::new(0.30, 0.12, 0.10);
        let diffuse = |lamp: &Lamp, share: f32| {
            let slope = hit.normal.dot(&lamp.direction);
            wrap.map(|w| ((slope + w) / (1.0 + w)).max(0.0))
                .component_mul(&lamp.color)
                * share
        };
        let sky = 0.5 + 0.5 * hit.normal.dot(&self.up);
        let ambient = V3::new(0.34, 0.30, 0.30) * (1.0 - sky) + V3::new(0.58, 0.60, 0.66) * sky;
        // What is hidden sees red tissue rather than black.
        let bounce = V3::new(open.powf(0.8), open.powf(1.25), open.powf(1.3));
        // Near the terminator the slope alone darkens; the shadow map would fray it.
        let slope = hit.normal.dot(&self.key.direction);
        let share = 1.0 - 0.88 * (1.0 - key) * ease(0.0, 0.35, slope);
        let light = diffuse(&self.key, share)
            + diffuse(&self.fill, open)
            + diffuse(&self.rim, 0.30 * open)
            + ambient.component_mul(&bounce);
        let wet = 1.0 - 0.7 * hit.tint;
        let gloss =
            self.gloss(hit, to_eye, key, 22.0) * 0.075 + self.gloss(hit, to_eye, key, 90.0) * 0.17;
        let fresnel = (1.0 - hit.normal.dot(to_eye).clamp(0.0, 1.0)).powi(4);
        let sheen = self.surroundings(&mirror(to_eye, &hit.normal))
            * (0.022 + 0.26 * fresnel)
            * open
            * open;
        albedo.component_mul(&light) * 0.74 + (gloss + sheen) * wet
    }

    fn steel(&self, hit: &Hit, albedo: V3, to_eye: &V3, key: f32, open: f32) -> V3 {
        let seen = self.surroundings(&mirror(to_eye, &hit.normal));
        let fresnel = (1.0 - hit.normal.dot(to_eye).clamp(0.0, 1.0)).powi(5);
        let share = (0.70 + 0.30 * key) * (0.4 + 0.6 * open) * 1.15;
        albedo.component_mul(&seen) * (0.75 + 0.25 * fresnel) * share
            + self.gloss(hit, to_eye, key, 60.0) * 0.55
    }

    fn plastic(&self, hit: &Hit, albedo: V3, to_eye: &V3, key: f32, open: f32) -> V3 {
        let slope = |lamp: &Lamp| hit.normal.dot(&lamp.direction).max(0.0);
        let light = self.key.color * (slope(&self.key) * (0.15 + 0.85 * key))
            + self.fill.color * slope(&self.fill)
            + V3::repeat(0.40 * open);
        let fresnel = (1.0 - hit.normal.dot(to_eye).clamp(0.0, 1.0)).powi(5);
        let sheen = self.surroundings(&mirror(to_eye, &hit.normal)) * (0.05 + 0.5 * fresnel) * open;
        albedo.component_mul(&light) * 0.6 + sheen + self.gloss(hit, to_eye, key, 50.0) * 0.22
    }

    /// Highlights of key and rim light.
    fn gloss(&self, hit: &Hit, to_eye: &V3, key: f32, power: f32) -> V3 {
        let lobe = |lamp: &Lamp| {
            let half = (lamp.direction + to_eye)
                .try_normalize(1e-6)
                .unwrap_or(*to_eye);
            let slope = hit.normal.dot(&lamp.direction);
            hit.normal.dot(&half).max(0.0).powf(power) * (slope * 4.0).clamp(0.0, 1.0)
        };
        self.key.color * (lobe(&self.key) * key) + self.rim.color * (0.35 * lobe(&self.rim))
    }

    /// The studio a polished surface mirrors: floor, horizon, sky and a soft box at the key light.
    fn surroundings(&self, direction: &V3) -> V3 {
        let height = direction.dot(&self.up);
        let floor = V3::new(0.34, 0.33, 0.33);
        let horizon = V3::new(0.60, 0.62, 0.66);
        let sky = V3::new(0.92, 0.95, 1.00);
        let base = floor
            + (horizon - floor) * ease(-0.5, 0.1, height)
            + (sky - horizon) * ease(0.1, 0.8, height);
        let panel = ease(0.70, 0.92, direction.dot(&self.key.direction));
        let strip = ease(0.75, 0.95, direction.dot(&self.fill.direction));
        base + V3::repeat(0.9) * panel + V3::repeat(0.35) * strip
    }
}

/// 0 below `low`, 1 above `high`, smooth between.
fn ease(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// The mirror image of the direction to the eye.
fn mirror(to_eye: &V3, normal: &V3) -> V3 {
    normal * (2.0 * normal.dot(to_eye)) - to_eye
}

fn decode(srgb: u8) -> f32 {
    let x = f32::from(srgb) / 255.0;
    if x <= 0.040_45 {
        x / 12.92
    } else {
        ((x + 0.055) / 1.055).powf(2.4)
    }
}

fn linear(srgb: [u8; 3]) -> V3 {
    V3::from(srgb.map(decode))
}
