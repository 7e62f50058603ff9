// Follow a throw frame by frame, as a game with Box2D does. The line FRAME stands for those of the page.
#include <cstdio>
#include <cstdlib>

struct b2Vec2 {
    float x, y;
    b2Vec2(float x, float y) : x(x), y(y) {}
};

struct b2Body {  // what a Box2D body does without collisions
    b2Vec2 place, velocity;
    float spin;
    b2Vec2 GetLinearVelocity() const { return velocity; }
    float GetAngularVelocity() const { return spin; }
    void SetLinearVelocity(b2Vec2 v) { velocity = v; }
    void SetAngularVelocity(float w) { spin = w; }
    void move(float dt) { place.x += dt * velocity.x; place.y += dt * velocity.y; }
};

// FRAME
int main(int, char **words)
{
    b2Body body = {b2Vec2(0.3f, 1.0f), b2Vec2(std::atof(words[1]), std::atof(words[2])),
                   static_cast<float>(std::atof(words[3]))};
    for (int k = 0; k < 100000; k++) {
        slow_down(&body, 0.001);
        body.move(0.001f);
    }
    std::printf("%.9g %.9g %g\n", body.place.x, body.place.y,
                std::fabs(body.velocity.x) + std::fabs(body.velocity.y) + std::fabs(body.spin));
}
