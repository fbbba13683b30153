#include "stream/display_changes.h"

namespace splatbus::stream {

namespace {

struct Bytesize {
  std::size_t operator()(const DisplayReset&) const { return 0; }
  std::size_t operator()(const DisplayAppend& c) const { return display_bytes(c.gaussians); }
  std::size_t operator()(const DisplayValues& c) const { return 4 * (c.columns.size() + c.values.size()); }
  std::size_t operator()(const DisplayObjects& c) const { return 8 * c.columns.size(); }
  std::size_t operator()(const DisplayLights& c) const { return 4 * c.ids.size(); }
  std::size_t operator()(const DisplaySeen& c) const { return 5 * c.columns.size(); }
  std::size_t operator()(const DisplayRemoval& c) const { return 4 * c.ascending.size(); }
  std::size_t operator()(const DisplayOrder& c) const { return 4 * c.order.size(); }
};

}  // namespace

std::size_t display_bytes(const QuantizedGaussians& gaussians) {
  return gaussians.count() * (4 * gaussians.channels.size() + 12);
}

std::size_t DisplayChanges::bytes_of(const DisplayChange& change) {
  return sizeof(DisplayChange) + std::visit(Bytesize{}, change);
}

}  // namespace splatbus::stream
