//! What can be decided, and how a decision is stated.

use crate::interpolation::SyncMethod;
use crate::lumigraph::BlendMethod;
use crate::method::Method;
use crate::options::ProxyMethod;
use serde::ser::{Serialize, SerializeStruct, Serializer};

/// The stages that a plan decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlanStage {
    Offsets,
    Sync,
    StillPairs,
    Trajectory,
    Proxy,
    Blend,
    Gains,
    Lenses,
    References,
}

/// What a stage was given: its method, or what is known of its input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// Every camera took one frame, so that offsets have no effect.
    NoOffsets,
    KnownClocks,
    EstimatedOffsets,
    Sync(SyncMethod),
    /// There is one frame a camera, so that there are no frame pairs.
    NoPairs,
    /// All frame pairs are registered.
    PairsRegistered,
    /// Frame pairs in which nothing changes are cross-faded.
    PairsCrossFaded,
    Straight,
    Curved,
    Proxy(ProxyMethod),
    /// The proxy of the given options is left as it is.
    ProxyAsGiven,
    Blend(BlendMethod),
    /// The blend of the given options is left as it is.
    BlendAsGiven,
    EqualGains,
    CorrectedGains,
    PinholeLenses,
    DistortedLenses,
    /// The epipolar test has references in one direction of the rig.
    OneDirection,
    /// The epipolar test has references in two directions of the rig.
    TwoDirections,
}

/// One stage's choice, and why. In JSON: `stage`, `method`, `measured`, `limit`, `because`.
#[derive(Clone, Debug, PartialEq)]
pub struct Decision {
    pub choice: Choice,
    /// What was measured, and the limit that it was compared with; pixels unless `because` says
    /// otherwise. `None` where the capture's description decides.
    pub measured: Option<f64>,
    pub limit: Option<f64>,
    /// One sentence with the number.
    pub because: String,
}

impl PlanStage {
    /// The stage as people write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Offsets => "offsets",
            Self::Sync => "sync",
            Self::StillPairs => "still pairs",
            Self::Trajectory => "trajectory",
            Self::Proxy => "proxy",
            Self::Blend => "blend",
            Self::Gains => "gains",
            Self::Lenses => "lenses",
            Self::References => "references",
        }
    }
}

impl Choice {
    /// The stage that it is a choice of.
    pub fn stage(self) -> PlanStage {
        match self {
            Self::NoOffsets | Self::KnownClocks | Self::EstimatedOffsets => PlanStage::Offsets,
            Self::Sync(_) => PlanStage::Sync,
            Self::NoPairs | Self::PairsRegistered | Self::PairsCrossFaded => PlanStage::StillPairs,
            Self::Straight | Self::Curved => PlanStage::Trajectory,
            Self::Proxy(_) | Self::ProxyAsGiven => PlanStage::Proxy,
            Self::Blend(_) | Self::BlendAsGiven => PlanStage::Blend,
            Self::EqualGains | Self::CorrectedGains => PlanStage::Gains,
            Self::PinholeLenses | Self::DistortedLenses => PlanStage::Lenses,
            Self::OneDirection | Self::TwoDirections => PlanStage::References,
        }
    }

    /// The choice as people write it; a method has its name in option files.
    pub fn name(self) -> &'static str {
        match self {
            Self::NoOffsets | Self::NoPairs => "none",
            Self::KnownClocks => "known clocks",
            Self::EstimatedOffsets => "estimated",
            Self::Sync(method) => method.name(),
            Self::PairsRegistered => "registered",
            Self::PairsCrossFaded => "cross-faded",
            Self::Straight => "straight",
            Self::Curved => "curved",
            Self::Proxy(method) => method.name(),
            Self::Blend(method) => method.name(),
            Self::ProxyAsGiven | Self::BlendAsGiven => "as given",
            Self::EqualGains => "equal",
            Self::CorrectedGains => "corrected",
            Self::PinholeLenses => "pinhole",
            Self::DistortedLenses => "distorted",
            Self::OneDirection => "one direction",
            Self::TwoDirections => "two directions",
        }
    }
}

impl Serialize for Decision {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut fields = serializer.serialize_struct("Decision", 5)?;
        fields.serialize_field("stage", self.choice.stage().name())?;
        fields.serialize_field("method", self.choice.name())?;
        fields.serialize_field("measured", &self.measured)?;
        fields.serialize_field("limit", &self.limit)?;
        fields.serialize_field("because", &self.because)?;
        fields.end()
    }
}
