#pragma once

// Bounds of the visibility test that its backends share.
namespace splatbus::relight {

constexpr float kGreatestSlope = 8.0F;       // metres of depth a metre across: beyond it the normal is no guide
constexpr float kLeastFacing = 0.02F;        // cosine below which no light arrives
constexpr float kLeastRadius_texels = 1.5F;  // the map's own resolution
constexpr float kGreatestRadius_texels = 24.0F;
// A paraboloid has the spread of a uniform disc that is smaller by this.
constexpr float kParaboloidOverDisc = 1.2247449F;
constexpr float kGreatestDeviation_m = 1.0F;

}  // namespace splatbus::relight
