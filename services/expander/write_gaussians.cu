// Gaussians of selected samples.
#include <cmath>

#include "device/parallel.h"
#include "expander/cell_search.h"
#include "expander/local_sample.h"

namespace splatbus::expander {

using device::for_each_index;

namespace {

struct WriteGaussian {
  Samples samples;
  ObjectFrames frames;
  const std::uint32_t* selected;
  float scale, log_flatness, opacity_logit;
  LightTerms light;
  InsertChannels out;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::size_t n = out.count;
    const std::uint32_t s = selected[i];
    const LocalSample local = localised(samples, frames, s);
    const float along = logf(local.spacing_m / local.metres_per_unit * scale);
    const math::Vec4 rotation = rotation_to_normal(local.normal);
    put(out.mean, n, i, local.position);
    put(out.log_scale, n, i, {along, along, along + log_flatness});
    put(out.rotation, n, i, rotation.xyz);
    out.rotation[3 * n + i] = rotation.w;
    out.opacity_logit[i] = opacity_logit;
    put(out.albedo, n, i, samples.albedo[s]);
    put(out.normal, n, i, local.normal);
    out.visibility[i] = guess_visibility(samples.color[s], samples.albedo[s], samples.normal[s], light);
    out.object_id[i] = local.frame_id;
  }
};

}  // namespace

void SampleSelector::write(const Samples& samples, std::uint32_t first, const InitialOptions& options,
                           const LightTerms& light, const InsertChannels& gaussians) const {
  for_each_index(stream_, gaussians.count,
                 WriteGaussian{samples, frames(), selected_.data() + first, options.scale, std::log(options.flatness),
                               std::log(options.opacity / (1 - options.opacity)), light, gaussians});
}

}  // namespace splatbus::expander
