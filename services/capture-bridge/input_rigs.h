#pragma once

#include <algorithm>
#include <cstdint>
#include <glm/glm.hpp>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "capture-bridge/camera_shares.h"
#include "capture-bridge/dome.h"
#include "capture-bridge/parameters.h"
#include "capture-bridge/range_finder.h"
#include "capture-bridge/requests.h"
#include "capture-bridge/viewers.h"

namespace splatbus::capture_bridge {

/// The input cameras of one viewer, and the rounds of their pictures.
struct InputRig {
  std::vector<Camera> cameras;
  /// Cameras of this place that are asked for when those are there: an engine that renders slowly does not get a whole
  /// dome at once, or a viewer who walks on would always wait for pictures of where he was.
  std::vector<Camera> to_come;
  DomePlace place;
  InputRound round;
  std::int64_t asked_ns = 0;     ///< last request for, or arrival of, a picture
  std::int64_t patience_ns = 0;  ///< before the next request for what is missing
  /// That the round under way was asked for, once the engine is known to answer; and how many pictures have come since.
  std::optional<std::int64_t> begun_ns;
  std::size_t arrivals = 0;
  std::int64_t submitted_ns = 0;  ///< a round, for sampling
  float new_share = 1;            ///< of the samples of its last round: they became Gaussians

  /// The camera that stands where the viewer will be, and goes ahead of the dome. Its picture is worth a look alone:
  /// what the viewer sees next is in it, and a dome takes an engine many pictures.
  std::optional<std::uint32_t> eye;
  Rigid eye_wished;            ///< where it was to look from last; if that was blind it stands elsewhere
  bool eye_in_flight = false;  ///< a picture of it, apart from the dome's, is on its way
  std::int64_t eye_asked_ns = 0;
  InputViewPointer glance;  ///< it, until it is handed on

  std::set<std::uint32_t> about;  ///< those that look about from the eye's place

  glm::vec3 anchor{0};                 ///< where the cameras could be seen from; blind ones draw nearer to it
  std::map<std::uint32_t, int> blind;  ///< how often a camera's picture was, by camera id
  std::map<std::uint32_t, std::uint64_t> requested;  ///< request ids, by camera id
  bool tested = false;                               ///< it stands in free space that was known
  std::uint64_t jumps = 0;                           ///< the viewer's, when it was placed
  std::optional<std::int64_t> jumped_ns;             ///< when it was placed for a jump
  std::optional<std::int64_t> waits_since_ns;        ///< for the free space about its viewer

  /// Whether it has stood anywhere. Others may have all of its cameras by now.
  [[nodiscard]] bool placed() const { return round.rig_generation() != 0; }
  /// Of this place's cameras: those that have been asked for.
  [[nodiscard]] double share_asked() const {
    return 1 - static_cast<double>(to_come.size()) /
                   static_cast<double>(std::max<std::size_t>(1, cameras.size() + to_come.size()));
  }
  /// Of `all` input cameras: those that are its own.
  [[nodiscard]] double share_owned(int all) const {
    return std::min(1.0, static_cast<double>(cameras.size() + to_come.size()) / all);
  }
};

/// The input cameras of all viewers, who share them by need. Times are CLOCK_MONOTONIC nanoseconds. Not thread-safe.
class InputRigs {
 public:
  using Rigs = std::map<std::string, InputRig>;  ///< by viewer; "" for the one about the place of interest

  /// Places the rigs that are due; with `anew` all of them. Returns the cameras that have left for good.
  std::vector<Camera> update(const Options& options, bool anew, const Viewers& viewers, const RangeFinder& ranges,
                             std::int64_t now_ns, CameraSet& cameras);

  /// The rig that waits for a picture; null when none does.
  [[nodiscard]] InputRig* awaiting(std::uint32_t camera_id, std::uint64_t request_id);
  /// A picture that the rig waits for has come.
  void arrived(InputRig& rig, std::uint32_t camera_id, std::uint64_t request_id, InputViewPointer view,
               std::int64_t now_ns);
  /// It has come and shows hardly more than what is right before it: the camera is asked for elsewhere, or given up.
  void blind(InputRig& rig, std::uint32_t camera_id, std::int64_t now_ns, CameraSet& cameras);

  /// Whether a rig waits for pictures of where it stands now, and has not yet had to ask again for them.
  [[nodiscard]] bool wait_for_pictures(std::int64_t deadline_ns) const;

  /// Has pictures rendered again: one, those of a rig that are missing, or all.
  void reissue(std::uint32_t camera_id, CameraSet& cameras);
  void reissue_missing(InputRig& rig, std::int64_t now_ns, CameraSet& cameras);
  void reissue_all(CameraSet& cameras);

  [[nodiscard]] Rigs& all() { return rigs_; }
  /// What samples of the rig under that generation came to.
  void note_new_share(std::uint64_t rig_generation, float share);
  /// Cameras that have been placed anew since this was asked last.
  [[nodiscard]] std::vector<std::uint32_t> take_placed() { return std::exchange(placed_, {}); }

 private:
  struct Wish {
    std::string name;
    const Viewer* viewer = nullptr;
    const FreeSpace* free = nullptr;
    DomePlace place;
    float need = 0;
  };
  [[nodiscard]] std::vector<Wish> wishes(const Options& options, const Viewers& viewers, const RangeFinder& ranges);
  /// `robbed`: others have so many of its cameras that it has no dome any more.
  [[nodiscard]] bool is_due(const Options& options, const Wish& wish, bool robbed, InputRig& rig,
                            std::int64_t now_ns) const;
  /// Returns how many of the cameras that are to come show what the viewer sees next, the first of them: they are asked
  /// for before the dome. 0: none has to go ahead.
  [[nodiscard]] std::size_t place(const Options& options, const Wish& wish, const CameraShares::Shares& shares,
                                  std::int64_t now_ns);
  /// Takes the first `ahead` of the cameras that are to come, or, with 0 or where these stand, so many as the engine
  /// renders in time for a round.
  void grow(const Options& options, const CameraSet& cameras, std::size_t ahead, InputRig& rig);
  /// The engine's rate, by a round that has come to its end.
  void measure(const InputRig& rig, std::int64_t now_ns);
  /// Has the eye look from where the viewer will be, once it has shown where it stood.
  void follow_eye(const Options& options, const Wish& wish, InputRig& rig, std::int64_t now_ns, CameraSet& cameras);
  void forget_left(const std::vector<Wish>& wishes, const CameraShares::Shares& shares);
  std::vector<Camera> request(const Options& options, const std::vector<std::string>& placed, std::int64_t now_ns,
                              CameraSet& cameras);
  [[nodiscard]] static std::map<std::uint32_t, std::uint64_t> own_requests(const InputRig& rig,
                                                                           const CameraSet& cameras);
  static void renew(InputRig& rig, const CameraSet& cameras);

  Rigs rigs_;
  CameraShares shares_;
  std::vector<std::uint32_t> placed_;
  std::uint64_t generations_ = 0;
  bool answered_ = false;                 // the engine has rendered an input camera
  std::optional<double> pictures_per_s_;  // of a round, as the last ones came
};

}  // namespace splatbus::capture_bridge
