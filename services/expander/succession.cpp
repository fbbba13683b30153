// How an expander goes on where the one before it has ended.

#include <spdlog/spdlog.h>

#include <algorithm>

#include "bus/handover.h"
#include "expander/expander.h"
#include "expander/handover.h"

namespace splatbus::expander {

void Expander::adopt_handover() {
  try {
    const bool adopted = bus::take_handover(*context_, [this](std::span<const std::byte> bytes) {
      read_handover({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()}, options_->cell_size_m,
                    inserter_.cells(), inserter_.filled());
    });
    if (adopted) spdlog::info("goes on with {} cells that were filled before", inserter_.filled().size());
  } catch (const std::exception& error) {
    spdlog::warn("what was filled is not known, as what was left cannot be used: {}", error.what());
  }
}

void Expander::leave_behind() {
  if (inserter_.filled().size() == 0) return;
  try {
    const std::vector<std::uint8_t> bytes =
        write_handover(options_->cell_size_m, inserter_.cells(), inserter_.filled());
    (void)bus::leave_handover(*context_, bytes.size(),
                              [&](std::byte* to) { std::ranges::copy(std::as_bytes(std::span(bytes)), to); });
  } catch (const std::exception& error) {
    spdlog::warn("what was filled is not kept for an expander that comes after: {}", error.what());
  }
}

}  // namespace splatbus::expander
