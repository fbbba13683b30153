#include "streamer/model_follower.h"

#include <sys/eventfd.h>

#include <algorithm>
#include <cassert>
#include <utility>

#include "bus/clock.h"
#include "bus/error.h"
#include "bus/memory.h"
#include "bus/trace.h"
#include "stream/bytes.h"

namespace splatbus::streamer {

namespace {

constexpr double kLeastShare = 1e-3;  // of the model: what is spent for less is not worth a budget

}  // namespace

ModelFollower::ModelFollower(stream::StreamModel& model, Device device)
    : model_(model), device_(device), done_event_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  if (!done_event_.valid()) throw bus::Error("cannot make an eventfd");
  thread_ = std::thread([this] { run(); });
}

ModelFollower::~ModelFollower() {
  {
    const std::scoped_lock lock(mutex_);
    stop_ = true;
    changed_.notify_all();
  }
  thread_.join();
}

void ModelFollower::start(Job job) {
  assert(!busy_);
  busy_ = true;
  const std::scoped_lock lock(mutex_);
  job_ = std::move(job);
  changed_.notify_all();
}

std::optional<ModelFollower::Result> ModelFollower::take_result() {
  const std::scoped_lock lock(mutex_);
  if (failure_) std::rethrow_exception(failure_);
  if (!result_) return std::nullopt;
  eventfd_t count = 0;
  (void)::eventfd_read(done_event_.get(), &count);
  busy_ = false;
  return std::exchange(result_, std::nullopt);
}

void ModelFollower::wait() {
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [this] { return result_ || failure_; });
}

void ModelFollower::run() {
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [this] { return stop_ || job_; });
    if (stop_) return;
    Job job = std::move(*std::exchange(job_, std::nullopt));
    lock.unlock();
    std::optional<Result> result;
    std::exception_ptr failure;
    try {
      result = follow(job);
    } catch (...) {
      failure = std::current_exception();
    }
    lock.lock();
    result_ = std::move(result);
    failure_ = failure;
    ::eventfd_write(done_event_.get(), 1);
    changed_.notify_all();
  }
}

std::optional<ModelFollower::Observed> ModelFollower::observe(const Job& job) {
  if (job.announcement) {
    const bool sensible = bus::guarded(*job.announcement, [&] {
      auto opened = PublishedModel::open(*job.announcement, device_, PublishedModel::Need::Average,
                                         published_ ? &*published_ : nullptr);
      if (!opened) return;
      if (published_) copied_before_ += published_->copied_bytes();
      published_ = std::move(*opened);
    });
    if (!sensible) bus::require_usable(device_);
  }
  if (!published_ || !published_->refresh()) return std::nullopt;
  const auto still_valid = [&] { return published_->still_valid(); };
  if (!job.share.pages) {
    if (!model_.observe(published_->average(), still_valid)) return std::nullopt;
    return Observed{.all = model_.observed_count(), .own = model_.observed_count()};
  }
  const PartOfModel part(published_->average(), *job.share.pages);
  if (!model_.observe(part.view, still_valid)) return std::nullopt;
  return Observed{.all = part.all, .own = part.own};
}

ModelFollower::Result ModelFollower::follow(Job& job) {
  const bus::TracedWork work("tick", 0, job.scene_version);
  const std::int64_t begin_ns = bus::now_ns(), begin_cpu_ns = bus::thread_cpu_ns();
  Result result;
  try {
    if (job.share.origin) model_.join(*job.share.origin);
    model_.raise_version(job.share.raise_version);
    const std::optional<Observed> observed = observe(job);
    result.fresh = observed.has_value();
    if (result.fresh) {
      result.generation = published_->generation();
      observed_ = observed->all;
    }
    // An empty model is not worth a beginning: the first Gaussians choose the quantizers. Where others have chosen
    // them, this one may have no page.
    if (result.fresh && model_.ready()) {
      const double share =
          observed->all > 0 ? static_cast<double>(observed->own) / static_cast<double>(observed->all) : 1;
      model_.set_holders(std::move(job.holders));
      result.spent_bytes = model_.make_tick(share * job.budget_bytes, job.cameras) / std::max(share, kLeastShare);
    } else if (result.fresh && observed->all > 0) {
      model_.reset_to_target();
      result.restarted = true;
    }
  } catch (const stream::StreamError& error) {
    result.error = error.what();
  }
  result.opened = published_.has_value();
  result.observed = observed_;
  result.unsent = model_.unsent();
  result.pending_deltas = model_.pending_deltas();
  result.full = model_.full();
  result.host_copied_bytes = copied_before_ + (published_ ? published_->copied_bytes() : 0);
  result.observed_bytes = model_.quantizer().copied_bytes();
  result.ms = static_cast<double>(bus::now_ns() - begin_ns) / 1e6;
  result.cpu_ms = static_cast<double>(bus::thread_cpu_ns() - begin_cpu_ns) / 1e6;
  return result;
}

}  // namespace splatbus::streamer
