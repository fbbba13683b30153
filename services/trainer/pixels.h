#pragma once

#include <cstddef>
#include <memory>
#include <utility>
#include <vector>

namespace splatbus::trainer {

/// An array that never changes and that several own, in either kind of memory; whoever holds it knows which.
template <class T>
class Pixels {
 public:
  Pixels() = default;
  Pixels(std::shared_ptr<const T> data, std::size_t size) : data_(std::move(data)), size_(size) {}
  /// In host memory.
  explicit Pixels(std::vector<T> values) : size_(values.size()) {
    auto owner = std::make_shared<const std::vector<T>>(std::move(values));
    data_ = {owner, owner->data()};
  }

  [[nodiscard]] const T* data() const { return data_.get(); }
  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] bool empty() const { return size_ == 0; }
  [[nodiscard]] std::size_t bytes() const { return size_ * sizeof(T); }
  /// Host memory only.
  const T& operator[](std::size_t i) const { return data_.get()[i]; }

 private:
  std::shared_ptr<const T> data_;
  std::size_t size_ = 0;
};

}  // namespace splatbus::trainer
