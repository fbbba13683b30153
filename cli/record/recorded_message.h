#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "bus/subscriber.h"
#include "bus/tensor.h"

// A message of the bus as the data of an MCAP message: its body, and behind it, each aligned to 64 bytes, the bytes of
// its tensors. Their Spans are of storage Inline and count from the start of the data, so that whoever reads the
// FlatBuffer finds them. A tensor that was not recorded keeps its Span of storage Slab. docs/record.md.
namespace splatbus::cli {

/// Bytes that are not zeroed first.
struct Blob {
  std::unique_ptr<std::byte[]> data;
  std::size_t size = 0;
  [[nodiscard]] std::span<const std::byte> bytes() const { return {data.get(), size}; }
};

/// How large the message's data will be. Throws bus::Error when a size overflows.
[[nodiscard]] std::size_t recorded_size(const bus::Message& message, bool with_slabs);

/// Reads slab tensors under their sequence locks, where asked for. Nullopt when one is gone already. Throws bus::Error
/// when a tensor lies.
[[nodiscard]] std::optional<Blob> to_recorded(const bus::Message& message, bool with_slabs);

/// What to_recorded() made, taken apart.
class RecordedMessage {
 public:
  /// Copies the body; the tensors' bytes stay in `data`. Throws bus::Error that says what is wrong.
  RecordedMessage(std::string_view topic, std::span<const std::byte> data);

  [[nodiscard]] const wire::Header& header() const { return *header_; }
  [[nodiscard]] std::span<std::uint8_t> body() { return {body_.data(), body_.size()}; }
  /// As in the header, with inline_data pointing into `data`, or with the Span of a slab that was not recorded.
  [[nodiscard]] const std::vector<bus::OutgoingTensor>& tensors() const { return tensors_; }
  [[nodiscard]] bool lacks_tensors() const { return lacks_tensors_; }

  /// Adds to the scene's version, and to those of its depth maps, wherever this message names them: a replay begins
  /// versions of its own, larger than those before it on this machine.
  void shift_scene_version(std::uint64_t shift);

 private:
  std::vector<std::uint8_t> body_;
  const wire::Header* header_ = nullptr;
  std::vector<bus::OutgoingTensor> tensors_;
  bool lacks_tensors_ = false;
};

}  // namespace splatbus::cli
