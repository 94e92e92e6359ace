//! The few calls of Embree 3 that are needed, as `rtcore.h` declares them for one level of instances and no curves of
//! minimal width.

use std::ffi::{c_char, c_int, c_uint, c_void};

use glam::Vec3;
use rebake_core::bvh::Ray;

const INVALID: c_uint = c_uint::MAX;
const FORMAT_UINT3: c_int = 0x5003;
const FORMAT_FLOAT3: c_int = 0x9003;
const BUFFER_INDEX: c_int = 0;
const BUFFER_VERTEX: c_int = 1;
const GEOMETRY_TRIANGLE: c_int = 0;
const QUALITY_HIGH: c_int = 2;
const SCENE_ROBUST: c_int = 1 << 2;

#[repr(C, align(16))]
struct RtcRay {
    origin: [f32; 3],
    near: f32,
    direction: [f32; 3],
    time: f32,
    far: f32,
    mask: c_uint,
    id: c_uint,
    flags: c_uint,
}

#[repr(C, align(16))]
struct RtcHit {
    normal: [f32; 3],
    u: f32,
    v: f32,
    primitive: c_uint,
    geometry: c_uint,
    instance: c_uint,
}

#[repr(C)]
struct RtcRayHit {
    ray: RtcRay,
    hit: RtcHit,
}

#[repr(C)]
struct Context {
    flags: c_int,
    filter: *const c_void,
    instance: c_uint,
}

unsafe extern "C" {
    fn rtcNewDevice(config: *const c_char) -> *mut c_void;
    fn rtcNewScene(device: *mut c_void) -> *mut c_void;
    fn rtcSetSceneFlags(scene: *mut c_void, flags: c_int);
    fn rtcSetSceneBuildQuality(scene: *mut c_void, quality: c_int);
    fn rtcNewGeometry(device: *mut c_void, kind: c_int) -> *mut c_void;
    fn rtcSetNewGeometryBuffer(
        geometry: *mut c_void,
        kind: c_int,
        slot: c_uint,
        format: c_int,
        stride: usize,
        count: usize,
    ) -> *mut c_void;
    fn rtcCommitGeometry(geometry: *mut c_void);
    fn rtcAttachGeometry(scene: *mut c_void, geometry: *mut c_void) -> c_uint;
    fn rtcCommitScene(scene: *mut c_void);
    fn rtcIntersect1(scene: *mut c_void, context: *mut Context, ray: *mut RtcRayHit);
    fn rtcOccluded1(scene: *mut c_void, context: *mut Context, ray: *mut RtcRay);
}

/// A committed scene of triangles. Kept until the process ends.
pub struct Embree(*mut c_void);

impl Embree {
    /// Builds at high quality; `robust` asks for watertight traversal. None where Embree does not start.
    pub fn build(corners: &[[Vec3; 3]], robust: bool) -> Option<Embree> {
        let vertices = corners.len() * 3;
        // SAFETY: the objects are used as the manual says; both buffers are written to exactly the size asked for,
        // and Embree pads vertex buffers that it allocates itself.
        unsafe {
            let device = rtcNewDevice(c"threads=2".as_ptr());
            if device.is_null() {
                return None;
            }
            let scene = rtcNewScene(device);
            rtcSetSceneFlags(scene, if robust { SCENE_ROBUST } else { 0 });
            rtcSetSceneBuildQuality(scene, QUALITY_HIGH);
            let geometry = rtcNewGeometry(device, GEOMETRY_TRIANGLE);
            let buffer = |kind, format, count| rtcSetNewGeometryBuffer(geometry, kind, 0, format, 12, count);
            let positions = buffer(BUFFER_VERTEX, FORMAT_FLOAT3, vertices).cast::<f32>();
            let indices = buffer(BUFFER_INDEX, FORMAT_UINT3, corners.len()).cast::<u32>();
            if positions.is_null() || indices.is_null() {
                return None;
            }
            for (i, x) in corners.iter().flatten().flat_map(|p| p.to_array()).enumerate() {
                positions.add(i).write(x);
            }
            for i in 0..vertices {
                indices.add(i).write(i as u32);
            }
            rtcCommitGeometry(geometry);
            rtcAttachGeometry(scene, geometry);
            rtcCommitScene(scene);
            Some(Embree(scene))
        }
    }

    fn context() -> Context {
        Context { flags: 0, filter: std::ptr::null(), instance: INVALID }
    }

    fn ray(ray: &Ray) -> RtcRay {
        RtcRay {
            origin: ray.origin.to_array(),
            near: ray.t_min,
            direction: ray.direction.to_array(),
            time: 0.0,
            far: ray.t_max,
            mask: u32::MAX,
            id: 0,
            flags: 0,
        }
    }

    /// Distance of the closest hit.
    pub fn closest_hit(&self, ray: &Ray) -> Option<f32> {
        let hit = RtcHit { normal: [0.0; 3], u: 0.0, v: 0.0, primitive: INVALID, geometry: INVALID, instance: INVALID };
        let mut query = RtcRayHit { ray: Self::ray(ray), hit };
        // SAFETY: the scene is committed, the structures have the layout of the header.
        unsafe { rtcIntersect1(self.0, &mut Self::context(), &mut query) };
        (query.hit.geometry != INVALID).then_some(query.ray.far)
    }

    /// Whether anything is hit.
    pub fn any_hit(&self, ray: &Ray) -> bool {
        let mut query = Self::ray(ray);
        // SAFETY: as above. A hit sets `far` to minus infinity.
        unsafe { rtcOccluded1(self.0, &mut Self::context(), &mut query) };
        query.far < 0.0
    }
}
