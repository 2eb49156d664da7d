//! Beyond the paper: a camera's image at an instant from all cameras: its own frames, and what other cameras
//! filmed nearer to the instant, seen from its place.
//!
//! A body that bounces between two frames leaves no trace of it in them. Another camera has a frame just
//! then.

use super::geometry::{CameraDepths, sampled};
use super::{LightField, RenderError};
use crate::interpolation::{SyncMethod, Synchronized};
use crate::lumigraph::BlendMethod;
use crate::options::{ProxyMethod, ViewOptions};
use rayon::prelude::*;
use std::sync::Arc;

/// The share of [`crate::lumigraph::BlendOptions::error_angle_rad`] that counts where a camera's own image is one of
/// those blended: it has no error of depth. Larger: where depth is wrong, other cameras' images replace it all the
/// same; smaller: they don't where they are better.
const OWN_SHARE: f64 = 0.25;
/// How many instants are cached. More only saves computing again.
pub(super) const MAX_CACHED_INSTANTS: usize = 2;

/// What all cameras' images at an instant share.
pub(super) struct Joint {
    /// Of each camera alone.
    images: Vec<Option<Synchronized>>,
    depths: Option<CameraDepths>,
}

impl LightField {
    /// A camera's image at a time between its frames, from all cameras near it.
    pub(super) fn joint(
        &self,
        camera: usize,
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<Synchronized, RenderError> {
        let mut options = options.clone();
        options.sync = SyncMethod::AllCameras.of_one_camera();
        options.proxy.method = ProxyMethod::Depth;
        options.blend.method = BlendMethod::SpaceTime;
        options.blend.error_angle_rad *= OWN_SHARE;
        let filmed = &self.capture().cameras[camera].camera;
        let mut cameras = self.geometry_cameras(filmed, time_s, &options);
        cameras.sort_unstable();
        let joint = self.joint_images(&cameras, time_s, &options)?;
        let Some(own) = joint.images[camera].clone() else {
            return self.synchronized(camera, time_s, &options);
        };
        let Some(geometry) = joint.depths.as_ref().and_then(|d| self.seen_from(filmed, d)) else {
            return Ok(own);
        };
        let blended = self.blend(&joint.images, &geometry, filmed, &options.blend);
        let gains = self.gains();
        let image = gains.as_filmed(camera, &blended.image).unwrap_or(blended.image);
        let mut result = own;
        let channels = result.image.channels();
        let pixels = result.image.data_mut().chunks_exact_mut(channels);
        for ((out, color), covered) in
            pixels.zip(image.data().chunks_exact(channels)).zip(&blended.coverage)
        {
            if *covered {
                for (out, color) in out.iter_mut().zip(color) {
                    *out = color.clamp(0.0, 1.0);
                }
            }
        }
        Ok(result)
    }

    /// Drops what views share besides registered frames, so that the next takes as long as the first one of an
    /// instant.
    pub(crate) fn forget_shared(&self) {
        self.joints.retain(|_| false);
        self.correspondences.retain(|_| false);
    }

    /// Makes what the images of these cameras share, before threads that don't know of each other make it.
    pub(super) fn share_joint(
        &self,
        cameras: &[usize],
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<(), RenderError> {
        if options.sync == SyncMethod::AllCameras
            && let Some(&first) = cameras.first()
        {
            self.synchronized(first, time_s, options)?;
        }
        Ok(())
    }

    /// The images of these cameras, each of its own frames, and their depths; cached.
    fn joint_images(
        &self,
        cameras: &[usize],
        time_s: f64,
        options: &ViewOptions,
    ) -> Result<Arc<Joint>, RenderError> {
        let key = JointKey::new(cameras, time_s, options);
        if let Some(joint) = self.joints.get(&key) {
            return Ok(joint);
        }
        let of = |c: &usize| self.synchronized(*c, time_s, options);
        let synchronized: Vec<Synchronized> =
            cameras.par_iter().map(of).collect::<Result<_, _>>()?;
        let mut images = vec![None; self.times_s.len()];
        for (&c, image) in cameras.iter().zip(synchronized) {
            images[c] = Some(image);
        }
        let first = &self.capture().cameras[cameras[0]].camera;
        let all = (cameras, cameras.len());
        let depths = match self.proxy(first, time_s, options) {
            Ok(proxy) => {
                let points = sampled(&proxy.depth_map(first), first);
                self.estimated(&self.corrected(&images), all, &points, options)
            }
            // Without a shape, other cameras can't help.
            Err(RenderError::NoPoints) => None,
            Err(error) => return Err(error),
        };
        let joint = Arc::new(Joint { images, depths });
        self.joints.insert(key, joint.clone(), 1);
        Ok(joint)
    }
}

/// What [`Joint`] depends on: cameras, the time's bits, and the options in JSON.
#[derive(Clone, PartialEq, Eq, Hash)]
pub(super) struct JointKey(Vec<usize>, u64, String);

impl JointKey {
    fn new(cameras: &[usize], time_s: f64, options: &ViewOptions) -> Self {
        let options = serde_json::json!([options.interpolation, options.proxy]).to_string();
        Self(cameras.to_vec(), time_s.to_bits(), options)
    }
}
