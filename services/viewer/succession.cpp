#include "viewer/succession.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cmath>
#include <cstring>
#include <stdexcept>

#include "bus/handover.h"
#include "wire/convert.h"
#include "wire/viewer_generated.h"

namespace splatbus::viewer {

std::string name_of(const PathOptions& path) {
  return fmt::format("{} {} {}", static_cast<int>(path.kind), path.start_s, path.file);
}

std::optional<Place> take_place(bus::Context& bus) {
  std::optional<Place> place;
  try {
    (void)bus::take_handover(bus, [&](std::span<const std::byte> bytes) {
      flatbuffers::Verifier verifier(reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size());
      if (!verifier.VerifyBuffer<wire::ViewerHandover>(nullptr)) throw std::runtime_error("it does not verify");
      const auto& left = *flatbuffers::GetRoot<wire::ViewerHandover>(bytes.data());
      if (!std::isfinite(left.path_s())) throw std::runtime_error("the time of its path is not finite");
      place = {.path = left.path()->str(), .path_s = left.path_s(), .camera = from_wire(*left.camera())};
    });
  } catch (const std::exception& error) {
    spdlog::warn("begins where its parameters say, as what was left cannot be used: {}", error.what());
  }
  return place;
}

void leave_place(bus::Context& bus, const Place& place) {
  flatbuffers::FlatBufferBuilder builder;
  const wire::Camera camera = to_wire(place.camera);
  builder.Finish(wire::CreateViewerHandoverDirect(builder, place.path.c_str(), place.path_s, &camera));
  try {
    (void)bus::leave_handover(bus, builder.GetSize(),
                              [&](std::byte* to) { std::memcpy(to, builder.GetBufferPointer(), builder.GetSize()); });
  } catch (const std::exception& error) {
    spdlog::warn("where it is is not kept for a viewer that comes after: {}", error.what());
  }
}

}  // namespace splatbus::viewer
