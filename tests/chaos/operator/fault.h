#pragma once

#include <chrono>
#include <random>
#include <string>
#include <vector>

namespace splatbus::chaos {

/// What an operator, or bad luck, does next: a verb of the program, a signal, or both at once.
struct OperatorFault {
  std::vector<std::string> verb;       ///< "swap", "trainer"; empty: none
  std::string killed;                  ///< a service, or one with ".next" for its successor; empty: nobody
  int signal = 0;                      ///< that it gets
  std::chrono::milliseconds after{0};  ///< the verb's start

  [[nodiscard]] std::string name() const;
};

/// Chosen by chance, from a seed. What it asks for is good in itself: whatever does not come about is a fault of ours,
/// unless somebody was killed meanwhile.
class OperatorFaults {
 public:
  explicit OperatorFaults(unsigned seed) : random_(seed) {}
  [[nodiscard]] OperatorFault next();
  [[nodiscard]] std::chrono::milliseconds pause();  ///< before it

 private:
  [[nodiscard]] std::size_t below(std::size_t end) { return random_() % end; }
  [[nodiscard]] std::vector<std::string> swap();
  [[nodiscard]] std::vector<std::string> parameter();

  std::mt19937_64 random_;
};

}  // namespace splatbus::chaos
