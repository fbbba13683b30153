#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <thread>

#include "../unit/bus/bus_fixture.h"
#include "budgets.h"
#include "bus/slab.h"

namespace splatbus::hostile {

/// A publisher of 16 MiB, again and again, as a model's: in a slab, and within the message where it is not of this
/// machine.
class ManyBytes {
 public:
  static constexpr std::size_t kBytes = 16 * kMiB;
  ManyBytes(const std::shared_ptr<bus::Context>& context, const std::string& topic,
            std::chrono::milliseconds period = std::chrono::milliseconds(20))
      : publisher_(context, topic), slab_(context->create_slab("many", 2, kBytes)) {
    thread_ = std::jthread([this, period](const std::stop_token& stop) {
      for (std::uint64_t i = 1; !stop.stop_requested(); ++i) {
        const auto slot = slab_->next_slot();
        const auto generation = slab_->end_write(slot);
        const bus::OutgoingTensor tensor{
            .name = "values", .shape = {kBytes / 4}, .span = slab_->span(slot, 0, kBytes, generation)};
        bus_test::publish_number(publisher_, i, true, "", {tensor});
        std::this_thread::sleep_for(period);
      }
    });
  }

 private:
  bus_test::NumberPublisher publisher_;
  std::shared_ptr<bus::Slab> slab_;
  std::jthread thread_;
};

}  // namespace splatbus::hostile
