#include "splats/axes.h"

#include <cassert>

namespace splatbus::splats {

namespace {

glm::vec3 turned(const glm::vec3& v) {
  return {-v.x, -v.y, v.z};
}

}  // namespace

Splat turned(Splat splat) {
  splat.mean = turned(splat.mean);
  splat.normal = turned(splat.normal);
  const glm::quat q = splat.rotation;
  splat.rotation = {-q.z, -q.y, q.x, q.w};  // (0, 0, 0, 1) * q
  // At (-x, -y, z) the basis functions of odd m are their own negatives; those are at odd l (l + 1) + m.
  for (std::size_t k = 1; k < splat.sh.size(); k += 2) splat.sh[k] = -splat.sh[k];
  return splat;
}

void turn(GaussiansBuffer& radiance) {
  assert(radiance.layout().appearance == Appearance::Radiance);
  for (std::size_t i = 0; i < radiance.count(); ++i) store(turned(load(radiance.view(), i)), radiance, i);
}

}  // namespace splatbus::splats
