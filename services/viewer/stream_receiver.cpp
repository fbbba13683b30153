#include "viewer/stream_receiver.h"

#include <sys/eventfd.h>

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "bus/clock.h"
#include "bus/error.h"
#include "viewer/ui/texts.h"

namespace splatbus::viewer {

namespace {

using namespace std::chrono_literals;

constexpr std::chrono::milliseconds kLongestPoll = 50ms;  // a client has more to do than to receive
constexpr std::int64_t kMeasureEveryNs = 250'000'000;
constexpr std::size_t kMaxScenes = 16;
// Of a model that may take the place of one that is seen: of the pages, or of as many Gaussians as were seen or as
// there is room for. What there is no room for is missing for ever, and over a slow link the rest comes in its time.
constexpr double kMostMissing = 0.02, kEnough = 0.9;
constexpr std::int64_t kLongestRenewalNs = 3'000'000'000;
constexpr std::size_t kMinBatchRows = 1 << 18;  // below that all is not worth its while

}  // namespace

StreamReceiver::StreamReceiver(ClientOptions options, Gives gives)
    : client_(std::move(options)), begin_ns_(bus::now_ns()), wake_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  if (!wake_.valid()) throw bus::Error("cannot make an eventfd");
  shown_.scene = std::make_shared<const SceneState>();
  if (gives == Gives::Rows) feed_.emplace(client_.replica(), true);
  thread_ = std::thread([this] { run(); });
}

StreamReceiver::~StreamReceiver() {
  {
    const std::scoped_lock lock(mutex_);
    stop_ = true;
  }
  wake();
  thread_.join();
}

void StreamReceiver::run() {
  try {
    while (true) {
      const bool changed = client_.poll(kLongestPoll, wake_.get());
      eventfd_t count = 0;
      (void)::eventfd_read(wake_.get(), &count);
      do_posted();
      hand_over(changed);
      const std::scoped_lock lock(mutex_);
      if (stop_) return;
    }
  } catch (...) {
    const std::scoped_lock lock(mutex_);
    failure_ = std::current_exception();
    arrived_.notify_all();
  }
}

void StreamReceiver::do_posted() {
  std::vector<std::function<void(StreamClient&)>> posted;
  {
    const std::scoped_lock lock(mutex_);
    posted.swap(posted_);
  }
  for (const auto& action : posted) action(client_);
}

ReceiverStatus StreamReceiver::measure() {
  const stream::Replica& replica = client_.replica();
  const stream::SceneDelays& delays = client_.scene_delays();
  return {.connected = client_.connected(),
          .pages = replica.pages(),
          .missing_pages = replica.missing_pages(),
          .received_bytes = client_.received_bytes(),
          .refused = client_.refused(),
          .lost = client_.lost(),
          .lacked = client_.lacked(),
          .scene_delays = delays.count(),
          .scene_delay_ms_p50 = delays.quantile(0.5),
          .scene_delay_ms_p99 = delays.quantile(0.99),
          .round_trip_ms = client_.round_trip_ms()};
}

bool StreamReceiver::replaces(const Renewal& renewal) const {
  const stream::Replica& replica = client_.replica();
  if (replica.count() == 0) return false;
  if (replica.count() >= renewal.enough || bus::now_ns() >= renewal.until_ns) return true;
  return static_cast<double>(replica.missing_pages()) <= kMostMissing * static_cast<double>(replica.pages());
}

void StreamReceiver::hand_over(bool changed) {
  const stream::Replica& replica = client_.replica();
  gl::SharedBatch batch = feed_ ? feed_->take(fade_time_s(bus::now_ns())) : nullptr;
  std::optional<ReceiverStatus> status;
  if (const std::int64_t now_ns = bus::now_ns(); now_ns - measured_ns_ > kMeasureEveryNs) {
    measured_ns_ = now_ns;
    status = measure();
  }
  if (renews_ && renews_->until_ns == 0 && replica.count() > 0) renews_->until_ns = bus::now_ns() + kLongestRenewalNs;
  if (renews_ && !replaces(*renews_)) {
    const std::scoped_lock lock(mutex_);
    if (status) status_ = *status;
    return;
  }
  if (renews_) all_due_ = true;
  renews_.reset();
  if (std::exchange(all_due_, false) && feed_) batch = feed_->everything();
  stream::DisplayChanges changes = client_.take_changes();
  changed = changed || !changes.empty() || batch;
  const SceneKey key{replica.epoch(), replica.scene_version(), replica.scene_instant().frame};
  std::shared_ptr<const SceneState> scene;
  if (changed && key != scene_key_) {
    scene = std::make_shared<const SceneState>(replica.scene());
    scene_key_ = key;
  }
  const std::scoped_lock lock(mutex_);
  shown_.changes.append(std::move(changes));
  // Whoever draws no more does not make this grow.
  if (replica.exceeds_whole(shown_.changes)) shown_.changes = replica.whole();
  if (batch) {
    if (batch->whole) {
      shown_.batches.clear();
      batch_rows_ = 0;
    }
    batch_rows_ += batch->update.rows.size() + batch->colors.rows.size();
    if (batch_rows_ > kMinBatchRows + 2 * feed_->capacity()) {
      shown_.batches.clear();
      batch = feed_->everything();
      batch_rows_ = batch->update.rows.size();
    }
    shown_.batches.push_back(std::move(batch));
  }
  shown_.gaussians = replica.count();
  shown_.visibility_version = replica.visibility_version();
  if (scene) {
    shown_.scene = scene;
    if (shown_.scenes.size() >= kMaxScenes) shown_.scenes.erase(shown_.scenes.begin());
    shown_.scenes.push_back({std::move(scene), replica.scene_instant().capture_ns, bus::now_ns()});
  }
  if (status) status_ = *status;
  changed_ = changed_ || changed;
  if (!answer_) answer_ = client_.take_probe_answer();
  if (changed_ || answer_) arrived_.notify_all();
}

bool StreamReceiver::take(Shown& shown) {
  const std::scoped_lock lock(mutex_);
  if (failure_) std::rethrow_exception(failure_);
  shown = std::exchange(shown_, {});
  shown_.scene = shown.scene;
  shown_.gaussians = shown.gaussians;
  shown_.visibility_version = shown.visibility_version;
  batch_rows_ = 0;
  return std::exchange(changed_, false);
}

void StreamReceiver::wait_for(std::chrono::nanoseconds timeout, bool answers) {
  std::unique_lock lock(mutex_);
  arrived_.wait_for(lock, timeout, [this, answers] { return changed_ || (answers && answer_) || failure_; });
}

std::optional<ProbeAnswer> StreamReceiver::take_probe_answer() {
  std::optional<ProbeAnswer> answer;
  {
    const std::scoped_lock lock(mutex_);
    answer = std::exchange(answer_, std::nullopt);
  }
  if (answer) wake();  // the next one
  return answer;
}

ReceiverStatus StreamReceiver::status() const {
  const std::scoped_lock lock(mutex_);
  return status_;
}

void StreamReceiver::wake() {
  ::eventfd_write(wake_.get(), 1);
}

void StreamReceiver::post(std::function<void(StreamClient&)> action) {
  {
    const std::scoped_lock lock(mutex_);
    posted_.push_back(std::move(action));
  }
  wake();
}

void StreamReceiver::set_budget(std::size_t max_gaussians, std::uint32_t max_kbps) {
  post([this, max_gaussians, max_kbps](StreamClient& client) {
    if (!client.set_budget(max_gaussians, max_kbps)) return;
    std::size_t shown = 0;
    {
      const std::scoped_lock lock(mutex_);
      shown = shown_.gaussians;
    }
    renews_.reset();
    if (shown > 0) {
      const auto most = static_cast<double>(std::min(shown, max_gaussians));
      renews_ = {.enough = static_cast<std::size_t>(kEnough * most)};
    }
    scene_key_ = {};
    if (feed_) feed_.emplace(client.replica(), true);
  });
}

void StreamReceiver::give_all() {
  post([this](StreamClient&) { all_due_ = true; });
}

std::future<ShownModel> StreamReceiver::copy_model() {
  const auto copy = std::make_shared<std::promise<ShownModel>>();
  post([this, copy](StreamClient& client) {
    if (renews_ || client.replica().count() == 0) {
      return copy->set_exception(std::make_exception_ptr(std::runtime_error(texts::kNoModel)));
    }
    copy->set_value({.changes = client.replica().whole(), .scene = client.replica().scene()});
  });
  return copy->get_future();
}

void StreamReceiver::send_pose(const Camera& camera) {
  post([camera](StreamClient& client) { client.send_pose(camera); });
}

void StreamReceiver::send_probe(std::uint64_t probe_id, const Camera& camera) {
  post([probe_id, camera](StreamClient& client) { client.send_probe(probe_id, camera); });
}

void StreamReceiver::send_quality(std::uint64_t probe_id, const metrics::Quality& quality,
                                  std::int64_t first_picture_ns) {
  post([probe_id, quality, first_picture_ns](StreamClient& client) {
    client.send_quality(probe_id, quality, first_picture_ns);
  });
}

}  // namespace splatbus::viewer
