#include "stream/display_changes.h"

namespace splatbus::stream {

namespace {

struct Bytesize {
  std::size_t operator()(const DisplayReset&) const { return 0; }
  std::size_t operator()(const DisplayRows& c) const {
    return display_bytes(c.gaussians.channels.size(), c.rows.size());
  }
  std::size_t operator()(const DisplayValues& c) const { return 4 * (c.rows.size() + c.values.size()); }
  std::size_t operator()(const DisplayObjects& c) const { return 8 * c.rows.size(); }
  std::size_t operator()(const DisplayBlocks& c) const { return 8 * c.blocks.size(); }
  std::size_t operator()(const DisplayLights& c) const { return 4 * c.ids.size(); }
  std::size_t operator()(const DisplaySeen& c) const { return 5 * c.rows.size(); }
  std::size_t operator()(const DisplayVisibility&) const { return 0; }
};

}  // namespace

std::size_t display_bytes(std::size_t channels, std::size_t rows) {
  return rows * (4 * channels + 16);
}

std::size_t DisplayChanges::bytes_of(const DisplayChange& change) {
  return sizeof(DisplayChange) + std::visit(Bytesize{}, change);
}

}  // namespace splatbus::stream
