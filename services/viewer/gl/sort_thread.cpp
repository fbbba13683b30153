#include "viewer/gl/sort_thread.h"

#include <chrono>
#include <utility>

#include "gaussians/depth_order.h"

namespace splatbus::viewer::gl {
namespace {

void place(DepthOrder& order, const Batch& batch) {
  if (batch.whole) {
    const std::size_t rows = order.rows();
    for (std::size_t row = 0; row < rows; ++row) order.hide(static_cast<std::uint32_t>(row));
  }
  for (std::size_t k = 0; k < batch.update.rows.size(); ++k) {
    const std::uint32_t row = batch.update.rows[k];
    if (row >= order.rows()) order.resize(std::size_t{row} + 1);
    const stream::GpuRecord& record = batch.update.records[k];
    if ((record.opacity_object & 0xFFU) == 0) {
      order.hide(row);
    } else {
      order.place(row, {record.mean[0], record.mean[1], record.mean[2]}, record.opacity_object >> 8);
    }
  }
}

}  // namespace

SortThread::SortThread() : thread_([this] { run(); }) {}

SortThread::~SortThread() {
  {
    const std::scoped_lock lock(mutex_);
    stop_ = true;
  }
  due_.notify_all();
  thread_.join();
}

void SortThread::add(SharedBatch batch) {
  const std::scoped_lock lock(mutex_);
  batches_.push_back(std::move(batch));
  ++added_;
  due_.notify_all();
}

void SortThread::look(SortView view) {
  const std::scoped_lock lock(mutex_);
  view_ = std::move(view);
  ++looks_;
  due_.notify_all();
}

bool SortThread::take(Sorted& sorted) {
  const std::scoped_lock lock(mutex_);
  if (!std::exchange(sorted_is_new_, false)) return false;
  std::swap(sorted.order, sorted_.order);
  sorted.batches = sorted_.batches;
  sorted.views = sorted_.views;
  sorted.sort_ms = sorted_.sort_ms;
  return true;
}

void SortThread::wait() {
  std::unique_lock lock(mutex_);
  done_.wait(lock, [this] { return looks_ == 0 || (sorted_.batches == added_ && sorted_.views == looks_); });
}

void SortThread::run() {
  DepthOrder order;
  std::vector<SharedBatch> batches;
  while (true) {
    SortView view;
    Sorted next;
    {
      std::unique_lock lock(mutex_);
      due_.wait(lock,
                [this] { return stop_ || (looks_ > 0 && (sorted_.views != looks_ || sorted_.batches != added_)); });
      if (stop_) return;
      batches.swap(batches_);
      view = view_;
      next.batches = added_;
      next.views = looks_;
    }
    for (const SharedBatch& batch : batches) place(order, *batch);
    batches.clear();
    order.set_transforms(view.transforms, view.far_field);
    const auto begin = std::chrono::steady_clock::now();
    const auto sorted = order.sort(view.view_z, view.near_m);
    next.sort_ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count();
    next.order.assign(sorted.begin(), sorted.end());
    const std::scoped_lock lock(mutex_);
    sorted_ = std::move(next);
    sorted_is_new_ = true;
    done_.notify_all();
  }
}

}  // namespace splatbus::viewer::gl
