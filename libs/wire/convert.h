#pragma once

#include <flatbuffers/flatbuffers.h>

#include "gaussians/light.h"
#include "wire/common_generated.h"

namespace splatbus {

// Between wire structs and our types. The from_wire functions throw std::runtime_error on values that make no sense
// (NaN, zero or huge sizes, a quaternion that is not near unit), naming the field.

[[nodiscard]] wire::Vec3 to_wire(const glm::vec3& v);
[[nodiscard]] wire::Rigid to_wire(const Rigid& rigid);
[[nodiscard]] wire::Camera to_wire(const Camera& camera);
[[nodiscard]] flatbuffers::Offset<wire::Light> to_wire(flatbuffers::FlatBufferBuilder& builder, const Light& light);
[[nodiscard]] flatbuffers::Offset<flatbuffers::Vector<const wire::ObjectTransform*>> to_wire(
    flatbuffers::FlatBufferBuilder& builder, const ObjectTransforms& objects);

[[nodiscard]] glm::vec3 from_wire(const wire::Vec3& v);
[[nodiscard]] Rigid from_wire(const wire::Rigid& rigid);
[[nodiscard]] Camera from_wire(const wire::Camera& camera);
[[nodiscard]] Light from_wire(const wire::Light& light);
[[nodiscard]] ObjectTransforms from_wire(const flatbuffers::Vector<const wire::ObjectTransform*>* objects);

}  // namespace splatbus
