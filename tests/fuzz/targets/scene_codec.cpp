// Scenes, lights among them: whole ones, and changes of one with a lamp and two objects.
#include "stream/scene_codec.h"

#include "target.h"
#include "toy_scene.h"

namespace stream = splatbus::stream;
using splatbus::fuzz::require;

SPLATBUS_FUZZ_TARGET(scene_codec, bytes) {
  static const stream::QuantizedScene known = stream::quantize_scene(splatbus::fuzz::toy_scene(1));
  splatbus::fuzz::Input input(bytes);
  const stream::QuantizedScene* base = input.number() % 2 == 0 ? nullptr : &known;
  try {
    const auto state = input.rest();
    const stream::QuantizedScene scene = stream::decode_scene(state, base, 7);
    require(stream::decode_scene(stream::encode_scene(scene, base), base, 7) == scene, "what was read can be sent on");
    splatbus::SceneState shown = stream::dequantize_scene(base == nullptr ? stream::QuantizedScene{} : *base);
    stream::dequantize_changes(base == nullptr ? stream::QuantizedScene{} : *base, scene, shown);
    require(shown.objects.size() == scene.objects.size(), "every object is shown");
  } catch (const stream::StreamError&) {  // refused
  }
}
