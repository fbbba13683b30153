#pragma once

#include <memory>
#include <optional>

#include "bus/subscriber.h"
#include "gaussians/model.h"

namespace splatbus {

/// A reader's hold on the trainer's live model, made from a model/published message. The memory stays mapped while this lives.
/// Values change in place while they are read (harmless); the structure is whole only while still_valid(): check it after reading and
/// throw the result away when it is false (a newer model/published is then on its way).
class PublishedModel {
 public:
  /// Nullopt when the slab is gone or its structure has moved on since. Throws bus::Error when the message lies (planes of other
  /// sizes than count and capacity say, NaN-free is not checked).
  [[nodiscard]] static std::optional<PublishedModel> open(const bus::Message& message);

  [[nodiscard]] std::uint64_t generation() const { return generation_; }
  [[nodiscard]] std::uint64_t step() const { return step_; }
  [[nodiscard]] const GaussiansView& live() const { return live_; }        ///< the parameters as the optimizer has them now
  [[nodiscard]] const GaussiansView& average() const { return average_; }  ///< averaged over time: what is shown and streamed
  [[nodiscard]] bool still_valid() const;

 private:
  std::uint64_t generation_ = 0, step_ = 0;
  GaussiansView live_, average_;
  std::shared_ptr<const void> keep_alive_;
  std::optional<bus::TensorView> probe_;
};

}  // namespace splatbus
