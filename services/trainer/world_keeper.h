#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "model/page_store.h"
#include "trainer/options.h"
#include "trainer/world_bytes.h"
#include "trainer/world_writer.h"
#include "world/world.h"

namespace splatbus::trainer {

/// Keeps a trainer's model in a world folder (docs/world-folder.md), so that after a crash at any moment what is lost
/// are at most the last two seconds of its structure: about once a second, all pages whose Gaussians are others are
/// copied between two steps and written as one commit, and beside them, as bytes a second allow, those whose values or
/// state have changed and were kept longest ago. Belongs to the thread that owns the store; compression and the disk
/// are a thread of its own.
class WorldKeeper {
 public:
  /// Opens the folder, or makes it. A store that is empty gets what the folder holds; one that holds a living model
  /// stands, and the folder follows. Where there is no room on the disk for a new one, it is made later. Throws
  /// world::WorldError when it is not a world of this layout, or is in use.
  WorldKeeper(model::PageStore& store, const WorldParameters& parameters);
  /// Keeps what there is to keep, for as long as a few seconds.
  ~WorldKeeper();
  WorldKeeper(const WorldKeeper&) = delete;
  WorldKeeper& operator=(const WorldKeeper&) = delete;

  /// Between two steps, as often as one likes. Pages go out of the store, and come back, inside of what `restructure`
  /// calls.
  using Restructure = std::function<void(const std::function<void()>& change)>;
  void turn(const Restructure& restructure = [](const std::function<void()>& change) { change(); });
  /// Where viewers are and will be soon, world frame, metres. Those of before hold when there are none.
  void see(std::vector<math::Vec3> places);

  /// Pages that the ceilings have room for when that share of them trains and the others rest; as many as there can be
  /// where there are none.
  [[nodiscard]] static std::size_t most_pages(const WorldParameters& parameters, const ParameterLayout& layout,
                                              Device device, double active_share);

  struct Stats {
    std::uint64_t disk_bytes = 0, spilled = 0, spilled_pages = 0;
    std::uint64_t rounds = 0, pages = 0;    ///< that were written
    std::uint64_t refused_rounds = 0;       ///< by the disk
    double copy_s = 0, longest_copy_s = 0;  ///< that the owner's thread has spent on it; in one turn
  };
  [[nodiscard]] Stats stats() const;

 private:
  using Clock = std::chrono::steady_clock;
  static constexpr std::chrono::seconds kRetryPeriod{5};  ///< of a disk that has refused
  /// Of a page as it is in the folder, or about to be.
  struct Kept {
    std::uint32_t page = 0;
    std::uint64_t generation = 0;  ///< of the page's entry; 0: to be written in any case
    std::uint64_t step = 0;
    std::uint64_t seen = 0;  ///< number of the last look at the store that found it
    std::uint64_t ids = 0;   ///< hash_of_ids() there; 0: not known
    std::uint64_t same = 0;  ///< generation of the page's entry that was found to have the same ids
    bool spilled = false;    ///< the folder says that it is nowhere else, and is to be told
  };
  struct Candidate {
    world::PageKey key;
    std::uint32_t page = 0;
    std::uint64_t step = 0;  ///< when it was kept last
  };

  using Pages = std::vector<std::optional<world::Page>>;
  [[nodiscard]] static world::PageKey key_of(const model::PageStructure& page) {
    return {page.frame_id, page.level, page.morton_first, page.id_first};
  }

  // world_restore.cpp
  void open();
  /// Whoever adopts the slabs later has to know of pages that only the folder has.
  void mark_elsewhere(const world::WorldProgress& progress);
  void restore();
  /// Of a page of the folder that has been put in as it was there.
  [[nodiscard]] Kept kept_as(const world::Page& page, std::uint32_t placed, std::uint64_t step) const;
  std::vector<std::uint32_t> put_in(Pages& pages, std::uint64_t next_gaussian_id);
  void follow();

  // world_keeper.cpp
  void finish(std::unique_ptr<KeepRound> round, const Restructure& restructure);
  [[nodiscard]] bool start_round(Clock::time_point now, double seconds);
  void look(std::vector<Candidate>& changed, std::vector<Candidate>& stale);
  /// Those that have the Gaussians that the folder has are stale, though their entries are others: they rest, or train
  /// again.
  void tell_apart(std::span<const Candidate> other, std::vector<Candidate>& changed, std::vector<Candidate>& stale);
  void stage(KeepRound& round, const Candidate& candidate, world::PageMark mark);
  /// Once what is staged has been copied.
  void note_ids(const KeepRound& round);

  // world_spill.cpp
  [[nodiscard]] std::size_t bytes_here() const;
  struct Excess {
    std::size_t bytes = 0, gaussians = 0;
  };
  /// What has to leave; nothing as long as no ceiling is near.
  [[nodiscard]] Excess excess() const;
  /// Pages that fit in below the margin, if they train.
  [[nodiscard]] std::size_t room_for_pages() const;
  [[nodiscard]] float distance_m(const world::PageKey& key, const PageBounds& bounds) const;
  [[nodiscard]] std::vector<Candidate> choose_victims() const;
  /// Whether the folder has the page as it is: nothing changes it as long as it rests.
  [[nodiscard]] bool is_kept(const Candidate& candidate) const;
  /// Whether pages that are wanted back wait for others to leave.
  [[nodiscard]] bool hurries(Clock::time_point now);
  void spill(const KeepRound& round, const Restructure& restructure);
  void forget(KeepRound& round);
  /// `arriving`: pages that have been read and are about to be put in.
  void start_fetch(const std::vector<world::PageKey>& arriving = {});
  void finish_fetch(const Restructure& restructure);
  void tell_spilled();

  model::PageStore& store_;
  WorldParameters parameters_;
  PageCost cost_;
  std::size_t ceiling_bytes_, ceiling_gaussians_;  ///< of memory; 0: none
  device::StreamView stream_;
  std::shared_ptr<world::World> world_;  ///< null: there is no room for it on the disk yet
  std::map<world::PageKey, Kept> kept_;
  std::map<world::PageKey, world::PageEntry> elsewhere_;  ///< pages that are in the folder alone
  std::vector<world::PageKey> uncommitted_;
  Clock::time_point next_fetch_{}, next_hurry_{};
  world::WorldProgress committed_;
  std::unique_ptr<KeepRound> spare_;
  std::vector<math::Vec3> places_;
  std::vector<float> wanted_m_;  ///< ascending distances of pages that are to come back and find no room
  std::vector<world::PageKey> reading_;
  std::future<Pages> read_;
  std::uint64_t looks_ = 0;
  double allowance_bytes_ = 0;
  Clock::time_point last_round_{}, next_round_{};
  bool failing_ = false;
  int open_rounds_ = 0;  ///< in a row that did not commit
  Stats stats_;
  std::optional<WorldWriter> writer_;  ///< with world_
};

}  // namespace splatbus::trainer
