//! Samplers, each as a pair of `sample` and `pdf`; one chi² test checks them all.

mod cone;
mod cosine;
mod discrete;
mod equirect;
mod mixture;
mod sphere;
mod triangle;

pub use cone::Cone;
pub use cosine::{cosine_hemisphere, cosine_hemisphere_pdf};
pub use discrete::Discrete;
pub use equirect::{Equirect, TexelChoice};
pub use mixture::{Mixture, Spheres};
pub use sphere::{uniform_sphere, uniform_sphere_pdf};
pub use triangle::{SphericalTriangle, uniform_barycentrics};

use glam::Vec3;

/// Two unit vectors that complete `n` to a right-handed orthonormal basis (Duff et al. 2017).
#[inline]
pub fn basis(n: Vec3) -> (Vec3, Vec3) {
    let sign = 1f32.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), Vec3::new(b, sign + n.y * n.y * a, -n.y))
}

#[cfg(test)]
pub(crate) mod chi2;
