// What WebGL takes many calls for.

/** @typedef {{program: WebGLProgram, uniforms: Record<string, WebGLUniformLocation>}} Program */

/** @param {WebGL2RenderingContext} gl @param {string} vertex @param {string} fragment @returns {Program} */
export function program(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, source] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]])) {
    const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) ?? "");
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) ?? "");
  /** @type {Record<string, WebGLUniformLocation>} */
  const uniforms = {};
  for (let k = 0; k < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); k++) {
    const name = gl.getActiveUniform(program, k)?.name ?? "";
    uniforms[name] = /** @type {WebGLUniformLocation} */ (gl.getUniformLocation(program, name));
  }
  return { program, uniforms };
}

/** @param {WebGL2RenderingContext} gl */
export function lineArray(gl) {
  const [array, buffer] = [gl.createVertexArray(), gl.createBuffer()];
  gl.bindVertexArray(array);
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.enableVertexAttribArray(0);
  gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
  gl.bindVertexArray(null);
  return { array, buffer };
}

/** @param {WebGL2RenderingContext} gl */
export const target = (gl) => ({ frame: gl.createFramebuffer(), colour: gl.createTexture(), depth: gl.createTexture(), width: 0 });

/** @param {WebGL2RenderingContext} gl @param {ReturnType<typeof target>} target @param {number} width
 * @param {number} height @param {number} inner @param {number} format @param {number} type */
export function allocate(gl, target, width, height, inner, format, type) {
  target.width = width;
  const attach = (/** @type {WebGLTexture} */ texture, /** @type {number} */ point, /** @type {number[]} */ [i, f, t]) => {
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, i, width, height, 0, f, t, null);
    for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, point, gl.TEXTURE_2D, texture, 0);
  };
  gl.activeTexture(gl.TEXTURE0);
  gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
  attach(target.colour, gl.COLOR_ATTACHMENT0, [inner, format, type]);
  attach(target.depth, gl.DEPTH_ATTACHMENT, [gl.DEPTH_COMPONENT24, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT]);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
}
