// What the windows of a convolution see, row by row, so that the convolution is a product of matrices. Channels lie side by
// side in images and rows, so that 16 bytes are copied at a time, whatever the numbers are.

// As in src/nn/cuda/unfold.rs. A chunk is 16 bytes.
struct Arguments {
    const uint4* images;  // (batch, height, width, chunks)
    uint4* rows;  // (pixels, kernel, kernel, chunks)
    unsigned chunks_of_all;  // that are written
    unsigned first;  // pixel of the strided images, counted through all of them
    unsigned chunks;  // of a pixel
    unsigned height;
    unsigned width;
    unsigned strided_height;
    unsigned strided_width;
    unsigned kernel;
    unsigned stride;
    unsigned before;  // zeros above and left of an image
};

extern "C" __global__ void unfold(const __grid_constant__ Arguments arguments) {
    const unsigned at = blockIdx.x * blockDim.x + threadIdx.x;
    if (at >= arguments.chunks_of_all) {
        return;
    }
    const unsigned chunk = at % arguments.chunks;
    const unsigned place = at / arguments.chunks;
    const unsigned across = place % arguments.kernel;
    const unsigned down = place / arguments.kernel % arguments.kernel;
    const unsigned pixel = arguments.first + place / arguments.kernel / arguments.kernel;
    const unsigned column = pixel % arguments.strided_width;
    const unsigned row = pixel / arguments.strided_width % arguments.strided_height;
    const unsigned image = pixel / arguments.strided_width / arguments.strided_height;
    // Left of or above an image, these are beyond it on the other side.
    const unsigned x = column * arguments.stride + across - arguments.before;
    const unsigned y = row * arguments.stride + down - arguments.before;
    uint4 numbers = make_uint4(0, 0, 0, 0);
    if (x < arguments.width && y < arguments.height) {
        const size_t seen = (size_t(image) * arguments.height + y) * arguments.width + x;
        numbers = arguments.images[seen * arguments.chunks + chunk];
    }
    arguments.rows[at] = numbers;
}
