#pragma once

#include <cstdint>

#include "device/stream.h"
#include "math/portable.h"

namespace splatbus::trainer {

/// An engine's albedo picture is black where no surface is, and the far field's Gaussians show their colour there: they
/// emit it (docs/decisions/0100). Trained on black, a sky that differs little from the background makes itself
/// transparent. So where `color` [pixels][4] has no surface (alpha 0, and `albedo`, of the same shape, is black) albedo
/// becomes the colour; where it has one in part, the background's share is added. Nothing is done in a picture that
/// shows nothing but the background (linear) behind its surfaces, to within two of 255: there is no far field in it, as
/// the bridge sees it too. All on the stream's device, and done when it returns.
void add_sky_albedo(device::StreamView stream, const std::uint8_t* color, std::uint32_t pixels,
                    const math::Vec3& background, std::uint8_t* albedo);

}  // namespace splatbus::trainer
