//! Directions towards an object: a mixture over spheres that together hold it, each by its cone.

use std::f32::consts::{FRAC_1_PI, PI};

use glam::Vec3;

use super::{Cone, cosine_hemisphere};

/// Spheres at most: every sample's density looks at all of them.
pub(crate) const MAX_SPHERES: usize = 16;

/// Spheres that hold a set of triangles.
#[derive(Clone, Debug, Default)]
pub struct Spheres {
    spheres: Vec<(Vec3, f32)>,
}

impl Spheres {
    /// Splits triangles at medians, always the group whose sphere is largest, until sixteen spheres stand or
    /// splitting gains nothing.
    pub fn new(triangles: &[[Vec3; 3]]) -> Spheres {
        let mut groups: Vec<(Vec3, f32, Vec<u32>)> = Vec::new();
        if !triangles.is_empty() {
            groups.push(bounded(triangles, (0..triangles.len() as u32).collect()));
        }
        while groups.len() < MAX_SPHERES {
            let Some(largest) = (0..groups.len())
                .filter(|&i| groups[i].2.len() > 1)
                .max_by(|&a, &b| groups[a].1.total_cmp(&groups[b].1).then(b.cmp(&a)))
            else {
                break;
            };
            let (left, right) = split(triangles, &groups[largest].2);
            let (left, right) = (bounded(triangles, left), bounded(triangles, right));
            let parent = groups[largest].1;
            if left.1 * left.1 + right.1 * right.1 > 1.9 * parent * parent {
                break;
            }
            groups[largest] = left;
            groups.push(right);
        }
        Spheres { spheres: groups.into_iter().map(|(c, r, _)| (c, r)).collect() }
    }

    /// One sphere around all, where there is any.
    pub fn bounding(&self) -> Option<(Vec3, f32)> {
        let (low, high) = self.spheres.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), (c, r)| {
            (l.min(*c - Vec3::splat(*r)), h.max(*c + Vec3::splat(*r)))
        });
        let center = (low + high) * 0.5;
        let radius = self.spheres.iter().map(|(c, r)| c.distance(center) + r).fold(0.0, f32::max);
        (!self.spheres.is_empty()).then_some((center, radius))
    }
}

fn bounded(triangles: &[[Vec3; 3]], group: Vec<u32>) -> (Vec3, f32, Vec<u32>) {
    let corners = || group.iter().flat_map(|&t| triangles[t as usize]);
    let (low, high) = corners().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), c| (l.min(c), h.max(c)));
    let center = (low + high) * 0.5;
    let radius = corners().map(|c| c.distance(center)).fold(0.0, f32::max);
    (center, radius * 1.0001, group)
}

fn split(triangles: &[[Vec3; 3]], group: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let centroid = |t: u32| triangles[t as usize].iter().sum::<Vec3>();
    let (low, high) =
        group.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), &t| (l.min(centroid(t)), h.max(centroid(t))));
    let axis = (high - low).max_position();
    let mut order = group.to_vec();
    order.sort_by(|&a, &b| centroid(a)[axis].total_cmp(&centroid(b)[axis]).then(a.cmp(&b)));
    let right = order.split_off(order.len() / 2);
    (order, right)
}

/// The spheres as seen from one point.
#[derive(Clone, Copy, Debug)]
pub struct Mixture {
    /// Cones with a running sum of their weights.
    cones: [(Cone, f32); MAX_SPHERES],
    count: usize,
    /// Weight of the cosine hemisphere: the point lies inside a sphere or next to it.
    hemisphere: f32,
    total: f32,
    n: Vec3,
}

impl Mixture {
    /// The mixture seen from `point` with unit normal `n`; none where no sphere rises above the horizon.
    pub fn new(spheres: &Spheres, point: Vec3, n: Vec3) -> Option<Mixture> {
        let mut mixture = Mixture {
            cones: [(Cone { axis: n, one_minus_cos: 0.0 }, 0.0); MAX_SPHERES],
            count: 0,
            hemisphere: 0.0,
            total: 0.0,
            n,
        };
        for &(center, radius) in &spheres.spheres {
            let height = n.dot(center - point);
            if height <= -radius {
                continue;
            }
            match Cone::to_sphere(point, center, radius) {
                Some(cone) if cone.one_minus_cos < 0.7 => mixture.push(cone, height, radius),
                _ => mixture.hemisphere = 1.0,
            }
        }
        if mixture.hemisphere > 0.0 {
            // As much as all cones together, so that neither starves.
            mixture.hemisphere = if mixture.total > 0.0 { mixture.total.max(0.25 * PI) } else { PI };
        }
        mixture.total += mixture.hemisphere;
        (mixture.total > 0.0).then_some(mixture)
    }

    fn push(&mut self, cone: Cone, height: f32, radius: f32) {
        // Projected solid angle, roughly: by the highest cosine that the sphere reaches.
        let distance = (radius * radius / (cone.one_minus_cos * (2.0 - cone.one_minus_cos))).sqrt();
        let cos = ((height + radius) / distance).clamp(0.02, 1.0);
        self.total += cone.solid_angle() * cos;
        self.cones[self.count] = (cone, self.total);
        self.count += 1;
    }

    /// Whether the point lies inside a sphere or next to it.
    pub fn is_close(&self) -> bool {
        self.hemisphere > 0.0
    }

    /// Bound on the projected solid angle that the object can cover, of the hemisphere's π.
    pub fn coverage(&self) -> f32 {
        (self.total * FRAC_1_PI).min(1.0)
    }

    /// A direction; it may point below the horizon, where its contribution is zero.
    #[inline]
    pub fn sample(&self, [u, v]: [f32; 2]) -> Vec3 {
        let target = u * self.total;
        let mut low = 0.0;
        for (cone, high) in &self.cones[..self.count] {
            if target < *high {
                return cone.sample([((target - low) / (high - low)).min(0.999_999_94), v]);
            }
            low = *high;
        }
        let rest = if self.hemisphere > 0.0 { (target - low) / self.hemisphere } else { 0.5 };
        if self.hemisphere > 0.0 {
            cosine_hemisphere(self.n, [rest.clamp(0.0, 0.999_999_94), v])
        } else {
            self.cones[self.count - 1].0.sample([0.5, v])
        }
    }

    /// Density of [`Mixture::sample`] per steradian.
    #[inline]
    pub fn pdf(&self, direction: Vec3) -> f32 {
        let mut low = 0.0;
        let mut sum = self.hemisphere * self.n.dot(direction).max(0.0) * FRAC_1_PI;
        for (cone, high) in &self.cones[..self.count] {
            sum += (high - low) * cone.pdf(direction);
            low = *high;
        }
        sum / self.total
    }
}
