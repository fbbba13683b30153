#include "linked_viewer.h"

#include <exception>
#include <utility>

#include "bus/clock.h"
#include "metrics/image_io.h"

namespace splatbus::cli {

namespace {

constexpr std::chrono::milliseconds kLongestPoll(20);

}  // namespace

LinkedViewer::LinkedViewer(const std::string& endpoint, const std::string& name)
    : client_({.endpoint = endpoint, .name = name}),
      display_(stream_),
      renderer_(raster::make_model_renderer(Device::Cpu, 1)) {
  status_.begun_ns = bus::now_ns();
  // Loses none: it sees each.
  client_.lose_packets([this](const stream::ParsedPacket& packet) {
    taken_.push_back({.at_ns = bus::now_ns(), .body = packet.body(), .bytes = packet.bytes()});
    const std::int64_t encoded_ns = packet.root().header()->publish_ns();
    const bool whole = packet.body() == wire::Body::Page;
    if ((whole || packet.body() == wire::Body::PageDelta) && encoded_ns != 0) {
      delivered_.push_back({.encoded_ns = encoded_ns, .whole = whole});
    }
    if (packet.body() == wire::Body::Welcome) tick_hz_ = packet.root().body_as_Welcome()->tick_hz();
    return false;
  });
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

LinkedViewer::~LinkedViewer() = default;

void LinkedViewer::run(const std::stop_token& stop) {
  try {
    while (!stop.stop_requested()) {
      client_.poll(kLongestPoll);
      const std::int64_t now_ns = bus::now_ns();
      const stream::Replica& replica = client_.replica();
      stream::DisplayChanges changes = client_.take_changes();
      const std::scoped_lock lock(mutex_);
      visibility_.add(changes);
      changes_.append(std::move(changes));
      if (replica.exceeds_whole(changes_)) changes_ = replica.whole();
      arrivals_.insert(arrivals_.end(), taken_.begin(), taken_.end());
      taken_.clear();
      for (Delivery& delivery : delivered_) delivery.there_ns = now_ns;
      deliveries_.insert(deliveries_.end(), delivered_.begin(), delivered_.end());
      delivered_.clear();
      status_.gaussians = replica.count();
      status_.whole = replica.pages() > 0 && replica.missing_pages() == 0;
      status_.refused = client_.refused();
      status_.visibility_version = replica.visibility_version();
      status_.tick_hz = tick_hz_;
      if (status_.first_ns == 0 && status_.gaussians > 0) status_.first_ns = now_ns;
      if (status_.whole_ns == 0 && status_.whole) status_.whole_ns = now_ns;
      if (camera_) client_.send_pose(*camera_);
    }
  } catch (...) {
    const std::scoped_lock lock(mutex_);
    failure_ = std::current_exception();
  }
}

void LinkedViewer::look(const Camera& camera) {
  const std::scoped_lock lock(mutex_);
  camera_ = camera;
}

LinkedViewer::Status LinkedViewer::status() const {
  const std::scoped_lock lock(mutex_);
  return status_;
}

std::vector<Arrival> LinkedViewer::arrivals() const {
  const std::scoped_lock lock(mutex_);
  return arrivals_;
}

std::vector<Delivery> LinkedViewer::deliveries() const {
  const std::scoped_lock lock(mutex_);
  return deliveries_;
}

std::optional<cv::Mat> LinkedViewer::draw(const Camera& camera, const SceneState& scene) {
  stream::DisplayChanges changes;
  stream::VisibilityHistory::Turn turn;
  {
    const std::scoped_lock lock(mutex_);
    if (failure_) std::rethrow_exception(failure_);
    std::swap(changes, changes_);
    turn = visibility_.turn_to(scene.version);
  }
  display_.apply(changes);
  if (display_.count() == 0) return {};
  display_.apply(turn.there);
  const GaussiansView view = display_.view(scene.light.sources);
  renderer_->read_in_place(view);
  renderer_->draw(camera, scene, {}, render_);
  display_.apply(turn.back);
  const bool linear = view.layout.appearance == Appearance::Transfer;
  return metrics::from_planes(render_.color.data.data(), camera.width, camera.height, linear);
}

}  // namespace splatbus::cli
