#pragma once

#include "stream/bytes.h"
#include "stream/quantized_scene.h"

namespace splatbus::stream {

/// The light's part of encode_scene.
void put_light(Bytes& out, const QuantizedScene& scene, const QuantizedScene* base);
/// Into `scene`, which has that of the base. Throws StreamError.
void read_light(ByteReader& reader, QuantizedScene& scene, bool whole);

}  // namespace splatbus::stream
