#include "stream/held_gaussians.h"

namespace splatbus::stream {

HeldGaussians::HeldGaussians(const StreamLayout& layout) {
  for (const AttributeChannels& a : layout.attributes()) {
    for (int c = 0; c < a.channels; ++c) channels.emplace_back(a.minimum, a.maximum);
  }
}

void HeldGaussians::grow() {
  for (HeldChannel& channel : channels) channel.grow();
  gaussian_id.grow();
  object_id.grow();
}

void HeldGaussians::move(std::size_t from, std::size_t to) {
  for (HeldChannel& channel : channels) channel.set(to, channel[from]);
  object_id.set(to, object_id[from]);
  gaussian_id.set(to, gaussian_id[from]);
}

void HeldGaussians::write(std::span<const std::uint32_t> rows, const QuantizedGaussians& from, std::size_t first) {
  for (std::size_t c = 0; c < channels.size(); ++c) {
    for (std::size_t i = 0; i < rows.size(); ++i) channels[c].set(rows[i], from.channels[c][first + i]);
  }
  for (std::size_t i = 0; i < rows.size(); ++i) {
    object_id.set(rows[i], from.object_id[first + i]);
    gaussian_id.set(rows[i], 0);
  }
}

QuantizedGaussians HeldGaussians::gather(std::span<const std::uint32_t> rows) const {
  QuantizedGaussians out;
  out.channels.resize(channels.size());
  out.resize(rows.size());
  for (std::size_t c = 0; c < channels.size(); ++c) {
    for (std::size_t i = 0; i < rows.size(); ++i) out.channels[c][i] = channels[c][rows[i]];
  }
  for (std::size_t i = 0; i < rows.size(); ++i) {
    out.object_id[i] = object_id[rows[i]];
    out.gaussian_id[i] = gaussian_id[rows[i]];
  }
  return out;
}

std::size_t HeldGaussians::bytes() const {
  std::size_t bytes = object_id.bytes() + gaussian_id.bytes();
  for (const HeldChannel& channel : channels) bytes += channel.bytes();
  return bytes;
}

}  // namespace splatbus::stream
