#include <gtest/gtest.h>

#include <exception>
#include <iostream>

#include "cuda_peer.h"

int main(int argc, char** argv) {
  if (argc == 3) {
    try {
      return splatbus::trainer::run_peer(argv[1], argv[2]);
    } catch (const std::exception& error) {
      std::cerr << error.what() << '\n';
      return 1;
    }
  }
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
