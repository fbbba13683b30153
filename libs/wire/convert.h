#pragma once

#include <flatbuffers/flatbuffers.h>

#include <cstdint>

#include "gaussians/light.h"
#include "wire/common_generated.h"

namespace splatbus {

// Between wire structs and our types. The from_wire functions throw std::runtime_error on values that make no sense
// (NaN or infinity, pictures that picture_size.h has no room for, a quaternion or sun direction that is not near unit,
// spherical harmonics of another length than 27, an object or a light twice, more than kMaxLightSources of them, a
// scale, a range or a cone that is none), naming the field. What is near unit is normalised. On the wire a light's
// coefficients lie colour by colour, in Light coefficient by coefficient.

[[nodiscard]] wire::Vec3 to_wire(const glm::vec3& v);
[[nodiscard]] wire::Rigid to_wire(const Rigid& rigid);
[[nodiscard]] wire::Camera to_wire(const Camera& camera);
[[nodiscard]] flatbuffers::Offset<wire::Light> to_wire(flatbuffers::FlatBufferBuilder& builder, const Light& light);
[[nodiscard]] flatbuffers::Offset<flatbuffers::Vector<const wire::ObjectTransform*>> to_wire(
    flatbuffers::FlatBufferBuilder& builder, const ObjectTransforms& objects);

[[nodiscard]] flatbuffers::Offset<wire::SceneState> to_wire(flatbuffers::FlatBufferBuilder& builder,
                                                            const SceneState& scene, std::uint64_t frame = 0,
                                                            double time_s = 0);

/// `field` is how a message about a bad value calls it.
[[nodiscard]] glm::vec3 from_wire(const wire::Vec3& v, const char* field = "vector");
[[nodiscard]] Rigid from_wire(const wire::Rigid& rigid, const char* field = "transform");
[[nodiscard]] Camera from_wire(const wire::Camera& camera);
/// A field that is absent is zero; the sun's direction may be absent, or zero, where its irradiance is zero.
[[nodiscard]] Light from_wire(const wire::Light& light);
[[nodiscard]] SceneState from_wire(const wire::SceneState& scene);
/// Null is no objects.
[[nodiscard]] ObjectTransforms from_wire(const flatbuffers::Vector<const wire::ObjectTransform*>* objects);

}  // namespace splatbus
