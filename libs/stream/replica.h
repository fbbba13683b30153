#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <set>
#include <vector>

#include "stream/display_changes.h"
#include "stream/replicated_state.h"

namespace splatbus::stream {

struct SequenceRange {
  std::uint64_t first = 0, last = 0;  ///< both included
  bool operator==(const SequenceRange&) const = default;
};
struct PageVersion {
  std::uint32_t page = 0, version = 0;
  bool operator==(const PageVersion&) const = default;
};

/// Is told of what changes in what a replica shows, when it has changed: for who reads the state in place, where
/// DisplayChanges bring copies.
class ShownObserver {
 public:
  virtual ~ShownObserver() = default;
  /// Another state is shown: nothing of it is known.
  virtual void on_reset(const ReplicatedState& shown) = 0;
  virtual void on_change(const ReplicatedState& shown, const Change& change) = 0;
};

/// What a viewer holds. Packets go in; scene, and what changes of the Gaussians, come out. Not thread-safe.
///
/// Every page is taken as it comes, and stays in its rows. What belongs to a page that is held otherwise, or was lost,
/// is no error of the stream: report() says it, and the page comes whole. Pages of another epoch replace those that are
/// held when they are about as many.
class Replica {
 public:
  explicit Replica(std::size_t max_gaussians = kMaxGaussians) : max_gaussians_(max_gaussians) {}

  /// From now on `observer`, which outlives this, is told, and take_changes() gives nothing.
  void observe_with(ShownObserver& observer);

  /// Takes any packet of the stream; those that are not about the model (ProbePicture, ...) are only counted. True when
  /// the picture may have changed. Throws StreamError when the packet is wrong: what is held stays as it was.
  bool receive(const ParsedPacket& packet);

  /// What a Held says, since the last one.
  struct Report {
    std::uint64_t newest = 0;
    std::vector<SequenceRange> missing;
    std::vector<PageVersion> lacks;
    std::vector<std::uint32_t> dropped;
    bool scene_lost = false;
    /// Whether it should not wait.
    [[nodiscard]] bool urgent() const { return !missing.empty() || !lacks.empty() || !dropped.empty() || scene_lost; }
  };
  [[nodiscard]] const Report& report() const { return report_; }
  /// After it was sent.
  void clear_report();
  /// All whole pages.
  [[nodiscard]] std::vector<PageVersion> held_pages() const;

  /// What a DisplayGaussians does, after all that was taken before, to show what is shown now. Few bytes more than
  /// twice those of whole(), however long nobody takes them.
  [[nodiscard]] DisplayChanges take_changes();
  /// What a DisplayGaussians does to show it, whatever it has shown before.
  [[nodiscard]] DisplayChanges whole() const;
  /// Whether it is better to take whole() than changes of that size.
  [[nodiscard]] bool exceeds_whole(const DisplayChanges& changes) const;

  /// Gaussians that are shown.
  [[nodiscard]] std::size_t count() const { return shown().count; }
  [[nodiscard]] const ParameterLayout& layout() const { return shown().layout.parameters(); }
  /// What they are lit by and where their objects are.
  [[nodiscard]] const SceneState& scene() const { return scene_state().scene; }
  [[nodiscard]] std::uint64_t scene_version() const { return scene_state().scene.version; }
  [[nodiscard]] const SceneInstant& scene_instant() const { return scene_state().instant; }
  /// Newest scene version that any Gaussians' visibility is of; 0 where it is the model's own.
  [[nodiscard]] std::uint64_t visibility_version() const { return held().visibility_version; }

  /// Epoch that is followed, 0 before the first Layout.
  [[nodiscard]] std::uint64_t epoch() const { return held().epoch; }
  /// Pages that the manifest has; those of them that are not held whole.
  [[nodiscard]] std::size_t pages() const { return manifest_.size(); }
  [[nodiscard]] std::size_t missing_pages() const;

  /// Exactly what is held of the newest epoch.
  [[nodiscard]] const ReplicatedState& held() const { return *held_; }
  /// What is shown: that of the epoch before while there is little of the newest. Valid until the next packet.
  [[nodiscard]] const ReplicatedState& shown() const { return before_ ? *before_ : *held_; }

 private:
  void number(const ParsedPacket& packet);
  void welcome(const wire::Welcome& body);
  void begin(const wire::Layout& body, std::uint64_t epoch);
  void take_manifest(const wire::Manifest& body);
  bool take(const ParsedPacket& packet);
  void note(const Change& change);
  void note(DisplayChange change);
  /// The pages of before go, once there are as many of the new ones.
  void replace_before();
  void lack(std::uint32_t page);
  void show_whole();
  [[nodiscard]] const ReplicatedState& scene_state() const;

  std::size_t max_gaussians_;
  std::unique_ptr<ReplicatedState> held_ = std::make_unique<ReplicatedState>();
  std::unique_ptr<ReplicatedState> before_;          ///< of the epoch before, while that is shown
  std::map<std::uint32_t, std::uint32_t> manifest_;  ///< Gaussians by page
  std::uint64_t manifest_gaussians_ = 0;
  bool manifest_whole_ = false;
  std::uint64_t connection_ = 0;
  Report report_;
  ShownObserver* observer_ = nullptr;
  DisplayChanges changes_;              ///< that nobody has taken yet; none where somebody observes
  std::uint64_t noted_visibility_ = 0;  ///< version of which changes_ has said so
};

}  // namespace splatbus::stream
